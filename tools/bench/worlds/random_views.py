"""Random views of any world: above its surface, free of collisions, and of its ground."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from oaisys_core.geometry import depth_to_points, pose_looking_at
from oaisys_core.types import Frame, Pose
from tools.bench.worlds.demo_views import Heights

MIN_RISE_M, MAX_RISE_M = 1.2, 12.0
"""Heights of the camera above the surface; drawn from a log-uniform distribution."""
MIN_DOWN_DEG, MAX_DOWN_DEG = 8.0, 80.0
"""Angles under the horizon at which views look."""
WITHIN = 0.7
"""Share of the stage's edges, around its centre, over which cameras are."""
FREE_M = 0.5
"""No surface reaches higher than this below the camera, up to this distance from it."""
RING = 8

CLOSE_SHARE, CLOSE_M = 0.05, 0.6
MIN_ON_STAGE = 0.75
"""Share of the pixels that show the stage: not sky and not the plain around it."""
TRIES = 500

Extent = tuple[float, float, float, float]
"""(min_x, min_y, max_x, max_y) in ``map``."""


@dataclass(frozen=True)
class StageSurface:
    """What random views are drawn over.

    Attributes:
        extent_m: Of the stage.
        heights_m: Heights of the topmost surface.
        depth: Renders depth from a pose; a small image suffices.
    """

    extent_m: Extent
    heights_m: Heights
    depth: Callable[[Pose], Frame]


def random_views(count: int, stage: StageSurface, rng: np.random.Generator) -> list[Pose]:
    """Return poses 1.2 to 12 m above the surface that look at it, from steep to nearly level.

    Raises:
        ValueError: Too few of `TRIES` draws per pose are usable.
    """
    poses: list[Pose] = []
    for _ in range(count * TRIES):
        pose = _draw_pose(stage, rng)
        if pose is not None and shows_stage(stage.depth(pose), stage.extent_m):
            poses.append(pose)
        if len(poses) == count:
            return poses
    raise ValueError(f"found {len(poses)} of {count} views in {count * TRIES} draws")


def _draw_pose(stage: StageSurface, rng: np.random.Generator) -> Pose | None:
    """Return a random pose, or None if something is within `FREE_M` of the camera."""
    x0, y0, x1, y1 = stage.extent_m
    middle, half = np.array((x0 + x1, y0 + y1)) / 2, np.array((x1 - x0, y1 - y0)) / 2
    x_m, y_m = middle + half * rng.uniform(-WITHIN, WITHIN, 2)
    rise_m = float(np.exp(rng.uniform(np.log(MIN_RISE_M), np.log(MAX_RISE_M))))
    heading_rad = rng.uniform(0, 2 * np.pi)
    down_rad = np.radians(rng.uniform(MIN_DOWN_DEG, MAX_DOWN_DEG))
    around_rad = 2 * np.pi * np.arange(RING) / RING
    ring = [(x_m + FREE_M * np.cos(a), y_m + FREE_M * np.sin(a), 0.0) for a in around_rad]
    # To a millimetre, so that ray casters whose last digits differ agree on the pose.
    surface_m = np.round(stage.heights_m([(x_m, y_m, 0.0), *ring]), 3)
    eye_m = np.array((x_m, y_m, surface_m[0] + rise_m))
    if not (surface_m <= eye_m[2] - FREE_M).all():
        return None
    level = np.cos(down_rad)
    ahead = (level * np.cos(heading_rad), level * np.sin(heading_rad), -np.sin(down_rad))
    return pose_looking_at(eye_m, eye_m + ahead)


def shows_stage(depth: Frame, extent_m: Extent) -> bool:
    """Return whether a depth image shows mostly the stage, and hardly anything close."""
    rotation, eye_m = depth.T_map_camera[:3, :3], depth.T_map_camera[:3, 3]
    with np.errstate(invalid="ignore"):
        xy_m = (depth_to_points(depth.data, depth.intrinsics) @ rotation.T + eye_m)[..., :2]
        on_stage = ((xy_m >= extent_m[:2]) & (xy_m <= extent_m[2:])).all(axis=-1)
    is_close = depth.data < CLOSE_M
    return float(on_stage.mean()) >= MIN_ON_STAGE and float(is_close.mean()) <= CLOSE_SHARE
