"""A vehicle that flies over terrain and maps what its camera sees."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import pose_to_matrix
from oaisys_core.geometry.poses import has_mask
from oaisys_core.types import DEPTH, FloatArray, Pose
from oaisys_gym.terrain_env import Observation, TerrainEnv
from oaisys_mapping.exploration.flight_box import flight_box
from oaisys_mapping.exploration.occupancy_map import OCCUPIED, Bounds, OccupancyMap
from oaisys_mapping.exploration.planner import Situation, Vehicle, level_pose
from oaisys_mapping.rectification import rectify, rectify_camera

MAP_CELLS = 32
"""Cells along an edge of an observed map."""

VOXEL_SIZE_M = 0.5
RADIUS_M = 0.5
"""Of the ball around the vehicle that must be free."""

SPEED_M_S = 2.0
VIEW_S = 1.0
"""A view takes so long beside the flight to it."""

SURFACE_REWARD_PER_M2 = 0.05
TIME_COST_PER_S = 0.02

REAL_KINDS = "fiu"
"""Of numpy's data types, those of an action."""

START_SHARE = 0.6
"""Episodes start in this share of the stage's width and depth, around its middle."""


class FlightEnv(TerrainEnv):
    """An environment of a flying vehicle, level, that looks along its heading.

    An observation has, beside the images,

    * ``map``: (32, 32) uint8 seen from above, x along the first axis: 0 where no surface has been
      observed, otherwise 1 to 255 for its height in the box that the vehicle flies in;
    * ``pose``: (4,) float32, -1 to 1: x, y and z in that box, and the heading over pi.
    """

    def __init__(self, **options: Any) -> None:
        """See `TerrainEnv`."""
        super().__init__(**options)
        self._vehicle = Vehicle(
            rectify_camera(self._sensor.intrinsics),
            self._sensor.T_base_camera,
            RADIUS_M,
            self.max_range_m,
        )
        self.observation_space = spaces.Dict(
            {
                **self.image_spaces,
                "map": spaces.Box(0, 255, (MAP_CELLS, MAP_CELLS), np.uint8),
                "pose": spaces.Box(-1.0, 1.0, (4,), np.float32),
            }
        )

    @property
    def situation(self) -> Situation:
        """What a planner of `oaisys_mapping.exploration` is given: map, vehicle, poses so far."""
        self.require_reset()
        return self._situation

    def _begin(self, height_m: float = 3.0) -> None:
        bounds = flight_box(tuple(self.extent_m.ravel()), self.surface_heights_m)
        middle_m, half_m = self.extent_m.mean(axis=0), np.ptp(self.extent_m, axis=0) / 2
        xy_m = middle_m + START_SHARE * half_m * self.np_random.uniform(-1, 1, 2)
        z_m = float(self.surface_heights_m(xy_m[None])[0]) + height_m
        start = level_pose((*xy_m, z_m), float(self.np_random.uniform(-np.pi, np.pi)))
        voxels = OccupancyMap(bounds, VOXEL_SIZE_M)
        voxels.set_free(start.position_m, RADIUS_M + 2 * VOXEL_SIZE_M)
        self._situation = Situation(self._vehicle, voxels, [], self.np_random)
        self._flown_m = 0.0
        self._view(start)

    def _view(self, pose: Pose) -> None:
        """Look from a pose and integrate its depth."""
        self._look(pose, with_depth=True)
        before = self._situation
        depth_m, _ = rectify(self._images[DEPTH], None, self._sensor.intrinsics)
        T_map_camera = pose_to_matrix(pose) @ self._vehicle.T_base_camera
        before.voxels.integrate(depth_m, self._vehicle.intrinsics, T_map_camera, self.max_range_m)
        self._situation = Situation(
            self._vehicle, before.voxels, [*before.visited, pose], self.np_random
        )

    def _observe(self) -> Observation:
        return self._observed_images() | flight_observation(self._situation)

    def _info(self) -> dict[str, Any]:
        return super()._info() | {"surface_m2": self._surface_m2(), "flown_m": self._flown_m}

    def _surface_m2(self) -> float:
        """Return the area of the observed surface, one face for each occupied voxel."""
        return float((self._situation.voxels.state == OCCUPIED).sum() * VOXEL_SIZE_M**2)


def flight_observation(situation: Situation) -> Observation:
    """Return ``map`` and ``pose`` of an observation; see `FlightEnv`."""
    return {
        "map": map_from_above(situation.voxels),
        "pose": scale_pose(situation.visited[-1], situation.voxels.bounds),
    }


def map_from_above(voxels: OccupancyMap, cells: int = MAP_CELLS) -> NDArray[np.uint8]:
    """Return the (cells, cells) heights of the observed surface, 1 to 255; 0: none observed.

    A cell has the highest of the surfaces in its columns of voxels.
    """
    occupied = voxels.state == OCCUPIED
    levels = occupied.shape[2] - occupied[:, :, ::-1].argmax(axis=2)
    levels = np.where(occupied.any(axis=2), levels, 0)
    for axis in (0, 1):
        starts = np.arange(cells) * levels.shape[axis] // cells
        levels = np.maximum.reduceat(levels, starts, axis=axis)
    scaled = 1 + (levels - 1) * 254 // max(1, occupied.shape[2] - 1)
    return np.where(levels > 0, scaled, 0).astype(np.uint8)


def scale_pose(pose: Pose, bounds: Bounds) -> NDArray[np.float32]:
    """Return (4,) x, y, z in a box and the heading over pi, -1 to 1; inverse: `unscale_pose`."""
    low_m, high_m = np.asarray(bounds.low_m), np.asarray(bounds.high_m)
    place = 2 * (np.asarray(pose.position_m) - low_m) / (high_m - low_m) - 1
    _, _, z, w = pose.quat_xyzw
    yaw_rad = (2 * np.arctan2(z, w) + np.pi) % (2 * np.pi) - np.pi
    return np.clip([*place, yaw_rad / np.pi], -1, 1).astype(np.float32)


def unscale_pose(scaled: NDArray[np.float32], bounds: Bounds) -> Pose:
    """Return the level pose for (4,) numbers from -1 to 1; inverse: `scale_pose`."""
    low_m, high_m = np.asarray(bounds.low_m), np.asarray(bounds.high_m)
    position_m = low_m + (np.asarray(scaled[:3], np.float64) + 1) / 2 * (high_m - low_m)
    return level_pose(position_m, float(scaled[3]) * np.pi)


def check_action(action: object, size: int) -> FloatArray:
    """Return an action as (size,) numbers, clipped to -1 to 1.

    Raises:
        InvalidInputError: It has another shape, or a number that is not finite or masked.
    """
    expected = f"{size} finite numbers from -1 to 1"
    if has_mask(action):
        raise InvalidInputError("action", action, f"{expected}, none of them masked")
    try:
        given = np.asarray(action)
    except (TypeError, ValueError) as error:  # rows of different lengths
        raise InvalidInputError("action", action, expected) from error
    is_real = given.shape == (size,) and given.dtype.kind in REAL_KINDS
    if not is_real or not np.isfinite(given).all():
        raise InvalidInputError("action", given.tolist(), expected)
    return np.clip(given.astype(np.float64), -1, 1)


def path_length_m(path_m: FloatArray) -> float:
    """Return the length of a path through (K, 3) positions."""
    return float(np.linalg.norm(np.diff(path_m, axis=0), axis=1).sum())
