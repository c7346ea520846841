"""Where the ground meets instances, and the dust that it leaves on them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.contact_map import ground_plane, stage_ground
from oaisys_core.procedural.terrain.surroundings.far_ground import with_land
from oaisys_core.render.shading.shading import mean_color
from oaisys_core.render.shading.texture_levels import LevelStore
from oaisys_core.scene import Scene, TerrainMaterial
from oaisys_core.types import FloatArray

REACH = 0.35
"""Distance from an instance's origin at which slopes of the ground are taken, in sizes."""

NO_GROUND = -100.0
"""Height of the ground below an instance where there is none, in sizes: it leaves no dust."""


@dataclass(frozen=True)
class GroundContact:
    """The ground around (N,) instances.

    Attributes:
        bed: (N, 3) float32: slopes along x and y, and height above the instance's origin in metres,
            of a plane through the ground below.
        dust: (N, 3) float32 linear colour of the ground there.
    """

    bed: NDArray[np.float32]
    dust: NDArray[np.float32]


class ContactGround:
    """Finds the contact of instances with the ground of a scene."""

    def __init__(self, scene: Scene, store: LevelStore) -> None:
        self._ground = with_land(stage_ground(scene), scene.far_ground)
        self._material, self._store = scene.material, store

    @cached_property
    def _colors(self) -> FloatArray:
        """(L, 3) mean linear colours of the layers."""
        return mean_colors(self._material, self._store)

    def __call__(self, T_map_object: FloatArray) -> GroundContact:
        """Return the contact of instances at (N, 4, 4) poses, on the stage or on the land."""
        position = T_map_object[:, :3, 3]
        size_m = np.linalg.norm(T_map_object[:, :3, 0], axis=1)
        slope, height_m = ground_plane(self._ground, position[:, :2], REACH * size_m)
        above_origin_m = height_m - position[:, 2]
        above_origin_m = np.where(np.isnan(above_origin_m), NO_GROUND * size_m, above_origin_m)
        bed = np.column_stack((slope, above_origin_m))
        dust = self._material.weights_at(position[:, :2]) @ self._colors
        return GroundContact(bed.astype(np.float32), dust.astype(np.float32))


def mean_colors(material: TerrainMaterial, store: LevelStore) -> FloatArray:
    """Return the (L, 3) linear mean colours of the layers."""
    return np.array([mean_color(store.levels(layer.maps)[-1]) for layer in material.layers])
