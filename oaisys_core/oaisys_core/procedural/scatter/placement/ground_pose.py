"""How an object stands on the ground."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oaisys_core.geometry import transform
from oaisys_core.procedural.scatter.placement.random_poses import bedding, leaning
from oaisys_core.scene import Ground, MeshPrototype
from oaisys_core.types import FloatArray

FOOT = 0.1
"""Share of an object's height up to which its vertices belong to its foot."""


SETTLED, DEEPEST = 0.8, 0.06
"""Share of the ground below a foot's edge that it touches or presses down, and how deep it sinks at
most for that, as a share of the foot's radius."""


class Footprint(NamedTuple):
    """The dimensions of a shape that matter for placing it on the ground.

    Attributes:
        height_m: Height of its highest point above its origin.
        foot_m: Radius of its foot.
    """

    height_m: float
    foot_m: float


def footprint_of(shape: MeshPrototype) -> Footprint:
    """Return the height of a shape and the radius of its foot."""
    vertices_m = shape.vertices_m.astype(np.float64)
    height_m = float(vertices_m[:, 2].max())
    foot = vertices_m[vertices_m[:, 2] <= FOOT * height_m]
    return Footprint(height_m, float(np.hypot(foot[:, 0], foot[:, 1]).max(initial=0.0)))


def pose_on_ground(
    ground: Ground, xy: tuple[float, float], yaw_rad: float, foot_m: float
) -> FloatArray:
    """Return the (4, 4) rigid pose of an object on the ground, with its z axis along the normal.

    It stands on the plane that best fits the ground below its foot, or a little lower, so that the
    foot touches an uneven ground nearly everywhere. A position outside the ground is moved to its
    rim.
    """
    from scipy.spatial.transform import Rotation

    x0, y0, x1, y1 = ground.extent_m
    centre = np.clip(np.array([xy]), (x0, y0), (x1, y1))
    radius_m = np.array([max(foot_m, ground.spacing_m / 2)])
    slope, _ = bedding(ground, centre, radius_m)
    angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    ring = centre + radius_m * np.column_stack((np.cos(angle), np.sin(angle)))
    below_m = ground.height_at(np.vstack((centre, ring)))
    height_m = float(np.nanmean(below_m))
    gap_m = height_m + (ring - centre) @ slope[0] - below_m[1:]
    height_m -= float(np.clip(np.nanquantile(gap_m, SETTLED), 0, DEEPEST * radius_m[0]))
    rotation = leaning(slope)[0] * Rotation.from_euler("z", yaw_rad)
    return transform(rotation.as_matrix(), (*centre[0], height_m))
