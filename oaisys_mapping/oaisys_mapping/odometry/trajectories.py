"""Trajectories as timed poses, and evo's judgement of them."""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, RotationSpline

from oaisys_core.types import FloatArray, ShortRepr
from oaisys_mapping.odometry.programs import ProgramError, program, program_folder, run_program

SEGMENT_M = 100.0
"""Length of the segments over which drift is measured, if the way is twice as long."""

MAX_OFFSET_S = 0.25
"""Largest offset in time that is searched for."""


@dataclass(frozen=True, repr=False)
class TimedTransforms(ShortRepr):
    """Poses of a frame at N increasing times.

    Attributes:
        times_s: (N,) times.
        T: (N, 4, 4) poses.
    """

    times_s: FloatArray
    T: FloatArray

    def at(self, times_s: ArrayLike) -> TimedTransforms:
        """Return the poses at (M,) times within ours, on smooth splines through ours."""
        times = np.asarray(times_s, dtype=np.float64)
        T = np.tile(np.eye(4), (len(times), 1, 1))
        T[:, :3, :3] = self._rotations(times).as_matrix()
        T[:, :3, 3] = self._positions(times)
        return TimedTransforms(times, T)

    @cached_property
    def _rotations(self) -> Any:
        return RotationSpline(self.times_s, Rotation.from_matrix(self.T[:, :3, :3]))

    @cached_property
    def _positions(self) -> Any:
        return scipy.interpolate.CubicSpline(self.times_s, self.T[:, :3, 3])

    def mount(self, T_body_sensor: ArrayLike) -> TimedTransforms:
        """Return the poses of a frame that is fixed to ours."""
        return TimedTransforms(self.times_s, np.asarray(self.T @ np.asarray(T_body_sensor)))

    def delay(self, delay_s: float) -> TimedTransforms:
        """Return the same poses at later times."""
        return TimedTransforms(self.times_s + delay_s, self.T)

    def way_m(self) -> float:
        """Return the length of the way."""
        steps_m = np.diff(self.T[:, :3, 3], axis=0)
        return float(np.linalg.norm(steps_m, axis=1).sum())

    def write_tum(self, path: Path) -> None:
        """Write a TUM file."""
        quats_xyzw = Rotation.from_matrix(self.T[:, :3, :3]).as_quat()
        table = np.column_stack((self.times_s, self.T[:, :3, 3], quats_xyzw))
        np.savetxt(path, table, fmt="%.9f")


def read_tum(path: Path) -> TimedTransforms:
    """Return the poses of a TUM file."""
    table = np.loadtxt(path, comments="#", ndmin=2)
    T = np.tile(np.eye(4), (len(table), 1, 1))
    T[:, :3, :3] = Rotation.from_quat(table[:, 4:8]).as_matrix()
    T[:, :3, 3] = table[:, 1:4]
    return TimedTransforms(table[:, 0], T)


Relation = Literal["trans_part", "angle_deg"]


def ape_rmse(
    reference: Path, estimate: Path, relation: Relation = "trans_part", *, aligned: bool = False
) -> float:
    """Return evo's absolute pose error (RMSE, metres or degrees) of two TUM files.

    Args:
        reference: The true poses.
        estimate: The poses to judge.
        relation: Which part of the error.
        aligned: Whether the first poses are made equal before.

    Raises:
        ProgramError: evo is not installed, or refuses the files.
    """
    return _evo("evo_ape", reference, estimate, relation, *(["--align_origin"] if aligned else []))


def drift_share(reference: Path, estimate: Path, way_m: float) -> float:
    """Return evo's mean relative translation error over segments, as a share of their length.

    The segments are all that are `SEGMENT_M` long, as in KITTI's benchmark, or half the way.

    Raises:
        ProgramError: evo is not installed, or refuses the files.
    """
    length_m = min(SEGMENT_M, way_m / 2)
    options = ["--delta", f"{length_m:.6f}", "--delta_unit", "m", "--all_pairs"]
    options += ["--pairs_from_reference"]
    return _evo("evo_rpe", reference, estimate, "trans_part", *options, figure="mean") / length_m


def _evo(
    name: str,
    reference: Path,
    estimate: Path,
    relation: Relation,
    *options: str,
    figure: str = "rmse",
) -> float:
    executable = program(name)
    if executable is None:
        raise ProgramError(f"{name} is not installed")
    with program_folder() as home:
        results = home / "results.zip"
        files = [reference.absolute(), estimate.absolute()]
        what = ["-r", relation, "--save_results", results, "--no_warnings"]
        run_program([executable, "tum", *files, *what, *options], home)
        with zipfile.ZipFile(results) as archive:
            return float(json.loads(archive.read("stats.json"))[figure])


def time_offset_s(estimate: TimedTransforms, truth: TimedTransforms) -> float:
    """Return by how much the times of an estimate are late, from its turns.

    It is the offset at which the angles by which the true body turns between the times of the
    estimate agree best with those of the estimate. They do not depend on frames.
    """
    turned_rad = _angles_rad(estimate.T)

    def disagreement(offset_s: float) -> float:
        expected_rad = _angles_rad(truth.at(times_s - offset_s).T)
        return float(np.mean((expected_rad - turned_rad[inside[:-1] & inside[1:]]) ** 2))

    first_s, last_s = truth.times_s[0] + MAX_OFFSET_S, truth.times_s[-1] - MAX_OFFSET_S
    inside = (estimate.times_s >= first_s) & (estimate.times_s <= last_s)
    times_s = estimate.times_s[inside]
    candidates_s = np.linspace(-MAX_OFFSET_S, MAX_OFFSET_S, 51)
    best_s = float(candidates_s[np.argmin([disagreement(each) for each in candidates_s])])
    step_s = float(candidates_s[1] - candidates_s[0])
    bounds = (max(best_s - step_s, -MAX_OFFSET_S), min(best_s + step_s, MAX_OFFSET_S))
    return float(scipy.optimize.minimize_scalar(disagreement, bounds=bounds, method="bounded").x)


def _angles_rad(T: FloatArray) -> FloatArray:
    """Return the (N - 1,) angles between successive orientations."""
    rotations = Rotation.from_matrix(T[:, :3, :3])
    return np.asarray((rotations[:-1].inv() * rotations[1:]).magnitude())
