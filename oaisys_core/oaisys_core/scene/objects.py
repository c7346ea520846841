"""The objects of a world: meshes with many instances, exact solids, tracks of wheels."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene.terrain_material import PbrMaps, TerrainMaterial
from oaisys_core.types import (
    FloatArray,
    ShortRepr,
)


@dataclass(frozen=True, repr=False)
class WaterSurface(ShortRepr):
    """The optics of a level mesh that is a surface of water.

    Attributes:
        opacity: (V,) uint8, by 255: how much of the bottom is hidden, without reflections.
        waves: Strength of ripples in reflections, 0 to 1.
    """

    opacity: NDArray[np.uint8]
    waves: float


Wrap = Literal["repeat", "clamp", "mirror"]
"""How an image goes on outside of its edges."""


@dataclass(frozen=True, repr=False)
class MeshMaterial(ShortRepr):
    """The colour of some of a mesh's triangles, and where they are cut out.

    The linear colour is that of the image, or ``color_srgb`` without one, times the colour of the
    vertices, if the mesh has any. Images are interpolated between the centres of their pixels.

    Attributes:
        name: That in its file.
        color_srgb: Uniform colour, 0 to 1.
        color_image_srgb: (H, W, 3) uint8, first row on top; None without an image.
        opacity: (H, W) uint8, of any size; None: nothing is cut out.
        cutoff: The surface is where the opacity, 0 to 255, is at least this; nothing hits the rest.
        wrap: Of both images, along u and v.
    """

    name: str = ""
    color_srgb: tuple[float, float, float] = (1.0, 1.0, 1.0)
    color_image_srgb: NDArray[np.uint8] | None = None
    opacity: NDArray[np.uint8] | None = None
    cutoff: float = 127.5
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")


FIRST_NEEDLE, NEEDLE_STEP = 2, 4
"""Values of `MeshPrototype.needles` on the first needle of a row, and from one to the next."""

MOST_NEEDLES = (255 - FIRST_NEEDLE) // NEEDLE_STEP
"""Largest number of needles from one end of a row to the other."""


@dataclass(frozen=True, repr=False)
class MeshPrototype(ShortRepr):
    """A mesh of which the world may contain many instances.

    Attributes:
        vertices_m: (V, 3) float32 in the object's frame, with the origin at the centre of its base.
        triangles: (T, 3) int32, counter-clockwise from outside.
        maps: Surface texture, projected from three sides (triplanar).
        ground: Material of the ground, of one layer, if it is rock of the ground itself: it has the
            colour of the ground at its place. With the ``maps`` of that layer.
        color_srgb: Uniform colour, used if there is no other.
        vertex_colors_srgb: (V, 3) uint8, interpolated over the triangles; not used with ``maps``.
        uv: (T, 3, 2) float32 texture coordinates of each triangle's corners in
            ``color_image_srgb``: (0, 0) is its lower left corner, (1, 1) its upper right one. The
            image repeats outside.
        color_image_srgb: (H, W, 3) uint8, first row on top; used instead of vertex colours.
        translucency: (V,) uint8, with ``vertex_colors_srgb``: by 255, the share of scattered light
            that leaves on the other side, as through leaves; None for none.
        needles: (V,) uint8, with ``translucency``: on what stands for rows of needles, its place
            across them; needles lie `FIRST_NEEDLE` + k `NEEDLE_STEP`. None for closed surfaces.
        materials: Used instead of ``color_image_srgb`` and ``color_srgb``, with ``uv``.
        material_of: (T,) uint16 index into ``materials`` of each triangle; None: the first.
        water: How it reflects and hides the bottom, if it is water.
        dust_m: Height above the ground up to which the ground's dust lies on it, at a scale of 1.
        crease_rad: Angle between two triangles from which the edge between them is shaded sharp;
            flatter edges are shaded as if the surface were smooth.
    """

    name: str
    vertices_m: NDArray[np.float32]
    triangles: NDArray[np.int32]
    maps: PbrMaps | None = None
    ground: TerrainMaterial | None = None
    color_srgb: tuple[float, float, float] = (0.5, 0.5, 0.5)
    vertex_colors_srgb: NDArray[np.uint8] | None = None
    uv: NDArray[np.float32] | None = None
    color_image_srgb: NDArray[np.uint8] | None = None
    translucency: NDArray[np.uint8] | None = None
    needles: NDArray[np.uint8] | None = None
    materials: tuple[MeshMaterial, ...] = ()
    material_of: NDArray[np.uint16] | None = None
    water: WaterSurface | None = None
    dust_m: float = 0.0
    crease_rad: float = pi

    @property
    def image_materials(self) -> tuple[MeshMaterial, ...]:
        """Its materials, or the one of ``color_image_srgb``; none if a texture set is on it."""
        if self.maps is not None:
            return ()
        if self.materials or self.uv is None or self.color_image_srgb is None:
            return self.materials
        return (MeshMaterial(self.name, color_image_srgb=self.color_image_srgb),)


FIRST_COVER_ID, FIRST_ROCK_FACE_ID = 2**31, 3 * 2**30
"""Id from which on things belong to the ground, of which images of instances show 0; and that from
which on they are rock of the ground itself."""


def ids_in_images(instance_ids: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return (...) ids as images of instances show them: 0 for what belongs to the ground."""
    is_cover = instance_ids >= FIRST_COVER_ID
    return np.where(is_cover, np.uint32(0), instance_ids) if is_cover.any() else instance_ids


@dataclass(frozen=True, repr=False)
class Placement(ShortRepr):
    """The instances of one prototype.

    Attributes:
        prototype: Index into `Scene.prototypes`.
        semantic_ids: From level 0 on.
        T_map_object: (N, 4, 4) float64, rotation times uniform scale, and translation.
        instance_ids: (N,) uint32, unique in the scene, from 1; from `FIRST_COVER_ID` on those of
            what belongs to the ground.
        is_moving: Whether its poses change with every sample; those of others rarely change.
        on_land: Whether they stand on the land around the stage: they are seen as it is, but are
            not part of the ground truth mesh.
    """

    prototype: int
    semantic_ids: tuple[int, ...]
    T_map_object: FloatArray
    instance_ids: NDArray[np.uint32]
    is_moving: bool = False
    on_land: bool = False

    @property
    def is_ground_cover(self) -> bool:
        """Whether they belong to the ground, as grass does: they are seen, and have its labels.

        They are no instances to a user.
        """
        return len(self.instance_ids) > 0 and int(self.instance_ids[0]) >= FIRST_COVER_ID

    @property
    def is_rock_face(self) -> bool:
        """Whether they belong to the ground and are rock: as hard as the ground itself."""
        return len(self.instance_ids) > 0 and int(self.instance_ids[0]) >= FIRST_ROCK_FACE_ID

    @property
    def is_solid(self) -> bool:
        """Whether they are part of heights and of the ground truth mesh: neither grass nor land."""
        return not self.on_land and (self.is_rock_face or not self.is_ground_cover)


@dataclass(frozen=True, repr=False)
class Primitive(ShortRepr):
    """An exact sphere or box, for tests and calibration targets.

    Attributes:
        shape: ``sphere`` (with radius size_m[0]) or ``box`` (with edge lengths size_m).
        T_map_object: (4, 4) rigid pose of its centre.
    """

    shape: str
    size_m: tuple[float, float, float]
    T_map_object: FloatArray
    instance_id: int
    semantic_ids: tuple[int, ...]
    color_srgb: tuple[float, float, float]


@dataclass(frozen=True, repr=False)
class WheelTracks(ShortRepr):
    """The tracks that a rover leaves on its way; colour only.

    Attributes:
        way_m: (K, 2) points of its whole way in ``map``.
        wheel_y_m: Distance of its wheels' middle from the way.
        width_m: Width of a wheel.
        driven_share: How much of the way has tracks by now, 0 to 1.
    """

    way_m: FloatArray
    wheel_y_m: float
    width_m: float
    driven_share: float
