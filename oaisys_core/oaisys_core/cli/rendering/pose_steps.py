"""The steps of a run whose views have the poses of a file."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from oaisys_core.cli.rendering.metadata_file import SampleRequest
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.poses import PoseSelection, of_rig, read_pose_table
from oaisys_core.files.poses.flight_plans import FlightPlan, read_plan
from oaisys_core.geometry import check_position, pose_looking_at, pose_looking_down
from oaisys_core.types import FloatArray, ModuleMetadata, Pose

if TYPE_CHECKING:
    from oaisys_core.simulation import Simulation

Point = tuple[float, float, float]
"""x, y, z in ``map``, metres."""


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


class ViewSteps:
    """Views that are all from one position, at one point.

    Args:
        position_m: Position of the rig in ``map``.
        target_m: Point in ``map`` at which it looks.
        count: Number of views of each world.
        is_on_ground: Whether z of both is counted from the topmost surface below them.

    Raises:
        InvalidInputError: One of the two is missing, or they are the same point.
    """

    batch = ModuleMetadata()

    def __init__(
        self,
        position_m: Point | None,
        target_m: Point | None,
        count: int,
        *,
        is_on_ground: bool = False,
    ) -> None:
        if position_m is None:
            raise InvalidInputError("position", None, "X Y Z in metres, as --look-at is given")
        if target_m is None:
            raise InvalidInputError("look-at", None, "X Y Z in metres, as --position is given")
        check_position(position_m, "position")
        check_position(target_m, "look-at")
        if position_m == target_m:
            raise InvalidInputError("look-at", target_m, "another point than --position")
        self._position_m = position_m
        self._target_m = target_m
        self._is_on_ground = is_on_ground
        self.count = count

    def requests(self, simulation: Simulation) -> tuple[SampleRequest, ...]:
        """Return the samples in a simulation's current world.

        Raises:
            InvalidInputError: With ``is_on_ground``, there is no ground below one of the points.
        """
        eye_m, target_m = self._position_m, self._target_m
        if self._is_on_ground:
            eye_m = _above_surface(simulation, "position", eye_m)
            target_m = _above_surface(simulation, "look-at", target_m)
        metadata = ModuleMetadata(sensor={"pose": _view(eye_m, target_m)})
        return (SampleRequest(metadata),) * self.count


def _above_surface(simulation: Simulation, option: str, point_m: Point) -> Point:
    """Return a point whose z was counted from the topmost surface below it."""
    x_m, y_m, z_m = point_m
    surface_m = float(simulation.query_height([point_m]).surface_height_m[0])
    if not isfinite(surface_m):
        raise InvalidInputError(option, point_m, "a point over the ground, for --on-ground")
    return x_m, y_m, surface_m + z_m


def _view(eye_m: Point, target_m: Point) -> Pose:
    """Return the pose at one point that looks at another one, also straight down."""
    if eye_m[:2] == target_m[:2] and target_m[2] < eye_m[2]:
        return pose_looking_down(*eye_m)
    return pose_looking_at(eye_m, target_m)
