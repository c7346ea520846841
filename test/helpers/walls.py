"""A map of a wall that one view has seen."""

from __future__ import annotations

import numpy as np

from oaisys_core.geometry import T_LINK_OPTICAL
from oaisys_core.types import PinholeIntrinsics
from oaisys_mapping.exploration.occupancy_map import Bounds, OccupancyMap

CAMERA = PinholeIntrinsics(160, 120, 135.0, 135.0, 79.5, 59.5)
BOX = Bounds(np.array([0.0, -6.0, -6.0]), np.array([12.0, 6.0, 6.0]))
WALL_M = 8.1


def seen_wall(voxel_size_m: float = 0.5) -> OccupancyMap:
    """Return a map after one view along x of a wall that fills the image."""
    voxels = OccupancyMap(BOX, voxel_size_m)
    depth_m = np.full((120, 160), WALL_M, np.float32)
    voxels.integrate(depth_m, CAMERA, T_LINK_OPTICAL, 20.0)
    return voxels
