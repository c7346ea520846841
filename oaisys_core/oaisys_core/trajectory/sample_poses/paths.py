"""Motions along a given path: poses of a file, survey grids and splines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import atan2
from typing import TYPE_CHECKING

import numpy as np
import scipy

from oaisys_core import geometry
from oaisys_core.config.sections.sensing.motion import CsvMotion, GridMotion, SplineMotion
from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.files.poses import PoseSelection, of_rig, read_pose_table
from oaisys_core.geometry.places import waypoints_in_map
from oaisys_core.trajectory.sample_poses.base import (
    Motion,
    MotionStep,
    at_height,
    index_in,
    looking_at,
    on_ground,
    pose_of,
)
from oaisys_core.types import FloatArray, Georeference, Pose, SensorInfo

if TYPE_CHECKING:
    from scipy.spatial.transform import RotationSpline

ARC_POINTS = 256
"""Points between two waypoints at which the length of a spline is measured."""

NORTH_UP_YAW_RAD = np.pi / 2
"""Yaw of a rig that looks down with the image's upper edge towards +y."""


class Csv(Motion):
    """See `CsvMotion`."""

    def __init__(self, config: CsvMotion, sensors: Sequence[SensorInfo]) -> None:
        self._config = config
        self.step_interval = config.step_interval
        selection = PoseSelection(config.columns, config.topic, config.frame)
        table = read_pose_table(config.path, selection)
        self._poses = of_rig(table, sensors, config.camera).poses

    def pose(self, step: MotionStep) -> Pose | None:
        """See `Motion.pose`."""
        from scipy.spatial.transform import Rotation

        count = len(self._poses)
        chosen = self._poses[index_in(step.index, count, self._config.at_end, "poses of the file")]
        moved_m = np.array(chosen.position_m) + self._config.offset_m
        position_m = at_height(moved_m, self._config, step, step.rng)
        rotation = Rotation.from_quat(chosen.quat_xyzw)
        return None if position_m is None else pose_of(position_m, rotation)


class Grid(Motion):
    """See `GridMotion`; the camera looks straight down, wherever it is mounted."""

    def __init__(self, config: GridMotion, sensors: Sequence[SensorInfo]) -> None:
        self._config = config
        self.step_interval = config.step_interval
        by_name = {sensor.name: sensor for sensor in sensors}
        name = sensors[0].name if config.camera is None else config.camera
        if name not in by_name:
            raise InvalidInputError("sensors.motion.camera", name, one_of(by_name, name))
        camera = by_name[name]
        self._T_link_base = geometry.T_LINK_OPTICAL @ geometry.invert(camera.T_base_camera)
        self._spacing_m = geometry.nadir_spacing_m(
            config.altitude_m, config.overlap, camera.intrinsics
        )

    def pose(self, step: MotionStep) -> Pose | None:
        """See `Motion.pose`."""
        config = self._config
        index = index_in(step.index, config.rows * config.columns, config.at_end, "views")
        row, column = divmod(index, config.columns)
        if row % 2:
            column = config.columns - 1 - column
        x0, y0, x1, y1 = step.ground.extent_m
        centre_m = config.centre_m or ((x0 + x1) / 2, (y0 + y1) / 2)
        if config.centre_lon_lat_deg is not None:
            field = "sensors.motion.centre_lon_lat_deg"
            ((x, y, _),) = waypoints_in_map(step.georeference, [config.centre_lon_lat_deg], field)
            centre_m = float(x), float(y)
        x = centre_m[0] + (column - (config.columns - 1) / 2) * self._spacing_m[0]
        y = centre_m[1] + ((config.rows - 1) / 2 - row) * self._spacing_m[1]
        camera_m = on_ground(np.array((x, y, 0.0)), config.altitude_m, step.ground)
        if camera_m is None:
            return None
        x, y, z = camera_m.tolist()
        link = geometry.pose_looking_down(x, y, z, NORTH_UP_YAW_RAD)
        return geometry.pose_from_matrix(geometry.pose_to_matrix(link) @ self._T_link_base)


class Spline(Motion):
    """See `SplineMotion`."""

    def __init__(self, config: SplineMotion) -> None:
        self._config = config
        self.step_interval = config.step_interval
        self._path: _Path | None = None
        self._georeference: Georeference | None = None

    def pose(self, step: MotionStep) -> Pose | None:
        """See `Motion.pose`."""
        path = self._path_of(step.georeference)
        at = self._parameter(path, step.index)
        position_m = at_height(path.curve(at), self._config, step, step.rng)
        if position_m is None:
            return None
        if path.rotations is not None:
            return pose_of(position_m, path.rotations(at))
        return self._facing(position_m, path.curve(at, 1))

    def _path_of(self, georeference: Georeference | None) -> _Path:
        """Return the path on a ground, which is the same for all steps of a batch."""
        if self._path is None or (
            self._config.waypoints_lon_lat_deg and georeference != self._georeference
        ):
            self._path = _Path.of(self._config, georeference)
            self._georeference = georeference
        return self._path

    def _facing(self, position_m: FloatArray, tangent: FloatArray) -> Pose:
        if self._config.look == "forward":
            return looking_at(position_m, position_m + tangent)
        x, y, z = position_m.tolist()
        return geometry.pose_looking_down(x, y, z, atan2(tangent[1], tangent[0]))

    def _parameter(self, path: _Path, index: int) -> float:
        """Return the spline parameter of a step, by arc length."""
        config, total_m = self._config, float(path.arc_m[-1])
        if config.is_closed:
            way_m = index * config.step_m % total_m
        else:
            count = int(total_m / config.step_m + 1e-9) + 1
            way_m = index_in(index, count, config.at_end, "steps of the path") * config.step_m
        return float(np.interp(way_m, path.arc_m, path.at))


@dataclass(frozen=True)
class _Path:
    """A spline, and its length.

    Attributes:
        curve: (3,) points by its parameter.
        rotations: By the same; None if they follow from the path.
        at, arc_m: Parameters, and the lengths up to them.
    """

    curve: scipy.interpolate.CubicSpline
    rotations: RotationSpline | None
    at: FloatArray
    arc_m: FloatArray

    @classmethod
    def of(cls, config: SplineMotion, georeference: Georeference | None) -> _Path:
        """Return the path through the waypoints of a configuration."""
        from scipy.spatial.transform import Rotation, RotationSpline

        waypoints_m = _waypoints_m(config, georeference)
        if config.is_closed:
            waypoints_m = np.vstack((waypoints_m, waypoints_m[:1]))
        knots = geometry.distances_along_m(waypoints_m)
        curve = scipy.interpolate.CubicSpline(
            knots, waypoints_m, bc_type="periodic" if config.is_closed else "natural"
        )
        rotations = None
        if config.quats_xyzw:
            quats = [*config.quats_xyzw, *(config.quats_xyzw[:1] if config.is_closed else ())]
            rotations = RotationSpline(knots, Rotation.from_quat(quats))
        at = np.concatenate([np.linspace(a, b, ARC_POINTS) for a, b in pairwise(knots)])
        return cls(curve, rotations, at, geometry.distances_along_m(curve(at)))


def _waypoints_m(config: SplineMotion, georeference: Georeference | None) -> FloatArray:
    """Return the (K, 3) waypoints; z is 0 where the height above the ground replaces it."""
    if config.waypoints_m:
        return np.array(config.waypoints_m)
    field = "sensors.motion.waypoints_lon_lat_deg"
    points_m = waypoints_in_map(georeference, config.waypoints_lon_lat_deg, field)
    return np.asarray(np.nan_to_num(points_m))
