"""The steps of a run whose views have the poses of a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from oaisys_core.cli.metadata_file import SampleRequest, Steps
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.poses import PoseSelection, of_rig, read_pose_table
from oaisys_core.files.poses.flight_plans import FlightPlan, read_plan
from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.types import FloatArray, ModuleMetadata, Pose

if TYPE_CHECKING:
    from oaisys_core.simulation import Simulation


class PoseSteps:
    """Views from the poses of a file.

    Args:
        path: The file.
        selection: What its name does not say.
        camera: See `of_rig`.

    Raises:
        InvalidInputError: The file cannot be read, or a pose is wrong.
    """

    batch = ModuleMetadata()

    def __init__(self, path: Path, selection: PoseSelection, camera: str | None) -> None:
        plan = read_plan(path)
        self._source = plan if plan is not None else read_pose_table(path, selection)
        self._camera = camera
        if plan is not None and camera is not None:
            expected = "none, because waypoints of a plan are those of the rig"
            raise InvalidInputError("--poses-camera", camera, expected)

    @property
    def count(self) -> int:
        """Number of samples of each batch."""
        if isinstance(self._source, FlightPlan):
            return len(self._source.waypoints)
        return len(self._source.places)

    def requests(self, simulation: Simulation) -> tuple[SampleRequest, ...]:
        """Return the samples in a simulation's current world.

        Raises:
            InvalidInputError: The rig has no such camera, or the world has no such place.
        """
        poses = self._poses(simulation)
        return tuple(SampleRequest(ModuleMetadata(sensor={"pose": pose})) for pose in poses)

    def _poses(self, simulation: Simulation) -> list[Pose]:
        info = simulation.info()
        if not isinstance(self._source, FlightPlan):
            return of_rig(self._source, info.sensors, self._camera).poses

        def heights(xy_m: FloatArray) -> FloatArray:
            points_m = np.column_stack((xy_m, np.zeros(len(xy_m))))
            return simulation.query_height(points_m, on_stage=True).ground_height_m

        return self._source.poses(info.georeference, heights)


def view_steps(
    position_m: tuple[float, float, float] | None,
    target_m: tuple[float, float, float] | None,
    samples: int,
) -> Steps:
    """Return the steps of a run whose views are all from one position, at one point.

    Args:
        position_m: Position of the rig in ``map``.
        target_m: Point in ``map`` at which it looks.
        samples: Number of views of each world.

    Raises:
        InvalidInputError: One of the two is missing, or they are the same point.
    """
    if position_m is None:
        raise InvalidInputError("position", None, "X Y Z in metres, as --look-at is given")
    if target_m is None:
        raise InvalidInputError("look-at", None, "X Y Z in metres, as --position is given")
    if position_m == target_m:
        raise InvalidInputError("look-at", target_m, "another point than --position")
    if position_m[:2] == target_m[:2] and target_m[2] < position_m[2]:
        pose = pose_looking_down(*position_m)
    else:
        pose = pose_looking_at(position_m, target_m)
    metadata = ModuleMetadata(sensor={"pose": pose})
    return Steps(ModuleMetadata(), (SampleRequest(metadata),) * samples)
