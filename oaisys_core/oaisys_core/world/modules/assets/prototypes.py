"""Prototypes of objects, made from built-in shapes and users' files."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config.sections.groups import GroupConfig
from oaisys_core.config.sections.objects import (
    Anchor,
    MoverConfig,
    PlacedObjectConfig,
    ShapedConfig,
)
from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.procedural.meshes.checks import FAR_M, check_float32_step, local_origin
from oaisys_core.procedural.meshes.files import (
    R_Z_UP_FROM_Y_UP,
    Y_UP_SUFFIXES,
    load_mesh,
)
from oaisys_core.procedural.meshes.loaded import LoadedMesh
from oaisys_core.procedural.scatter.groups import size_classes_m
from oaisys_core.procedural.scatter.rocks import ROCK_KINDS
from oaisys_core.procedural.scatter.shapes import check_shape, make_shape
from oaisys_core.procedural.textures import TEXTURES, default_cache_dir, texture_set
from oaisys_core.scene import MeshPrototype, PbrMaps
from oaisys_core.types import FloatArray

LOG = logging.getLogger(__name__)

FAR_SIZES = 100
"""Distance of a mesh from its origin, in its sizes, from which float32 blurs it."""

MAX_STEP_SHARE = 0.001
"""Step of the numbers of such a mesh's file, as a share of its size, beyond which it is refused."""

ROCK_VARIANTS, OTHER_VARIANTS = 24, 3
"""Number of meshes of a group that says nothing else."""


class PrototypeLibrary:
    """Makes prototypes, and reads each file and texture only once.

    Args:
        rock_texture: Texture set of rocks without their own.
        tile_m: Edge length of its tile, and of other textures without ``tile_m``.
        size_px, seed: Size and seed of built-in texture sets.
    """

    def __init__(self, rock_texture: str, tile_m: float, size_px: int | None, seed: int) -> None:
        self._rock_texture, self._tile_m = rock_texture, tile_m
        self._size_px, self._seed = size_px, seed
        self._maps: dict[tuple[str, float], PbrMaps] = {}
        self._edges: dict[tuple[Path, str | None], NDArray[np.floating[Any]]] = {}
        self._files: dict[tuple[Any, ...], MeshPrototype] = {}

    def check(self, config: ShapedConfig, field: str) -> None:
        """Raise on shapes and textures that do not exist, and on files without a mesh.

        Raises:
            InvalidInputError: Its path begins with ``field``.
            BackendUnavailableError: It is a .blend file and Blender is not installed.
        """
        if config.shape is not None:
            check_shape(config.shape, f"{field}.shape")
        if config.texture is not None and config.texture not in TEXTURES:
            expected = one_of(TEXTURES, config.texture)
            raise InvalidInputError(f"{field}.texture", config.texture, expected)
        if config.file is not None:
            self._from_file(config, f"{field}.file")

    def rock_maps(self) -> PbrMaps:
        """Return the texture set of rocks without their own."""
        return self._texture(self._rock_texture, self._tile_m)

    def prototype(
        self,
        config: ShapedConfig,
        rng: np.random.Generator,
        largest_m: float = 1.0,
        detail: int | None = None,
        plant_m: float = 1.0,
    ) -> MeshPrototype:
        """Return the prototype of an object at its own size.

        Args:
            rng: Draws built-in shapes.
            largest_m, detail, plant_m: See `make_shape`.
        """
        if config.shape is not None:
            look = make_shape(config.shape, rng, largest_m, detail, plant_m)
        else:
            look = self._from_file(config, "file")
        return self._color(look, config)

    def group_prototypes(self, group: GroupConfig, rng: np.random.Generator) -> list[MeshPrototype]:
        """Return the variants of each size class of a group, each 1 m along its longest axis."""
        usual = ROCK_VARIANTS if group.shape in ROCK_KINDS else OTHER_VARIANTS
        count = 1 if group.shape is None else group.variants or usual
        classes = size_classes_m(group)
        count = -(-count // len(classes))
        looks = [
            self.prototype(group, rng, group.size_m[1], group.detail, middle_m)
            for middle_m in classes
            for _ in range(count)
        ]
        if group.shape is None:
            return [_of_size_1(look) for look in looks]
        return [look if _is_of_size_1(look) else _of_size_1(look) for look in looks]

    def _color(self, look: MeshPrototype, config: ShapedConfig) -> MeshPrototype:
        if config.color_srgb is not None:
            return _of_one_color(look, config.color_srgb)
        texture = config.texture
        if texture is None and config.shape in ROCK_KINDS:
            texture = self._rock_texture
        if texture is None:
            return look
        return replace(look, maps=self._texture(texture, config.tile_m or self._tile_m))

    def _texture(self, name: str, tile_m: float) -> PbrMaps:
        if (name, tile_m) not in self._maps:
            maps = texture_set(name, self._size_px, self._seed, default_cache_dir())
            self._maps[name, tile_m] = replace(maps, tile_m=tile_m)
        return self._maps[name, tile_m]

    def _from_file(self, config: ShapedConfig, field: str) -> MeshPrototype:
        path = config.file
        if path is None:
            raise InvalidInputError(field, path, "a file")
        anchor: Anchor = "origin"
        far = 0.0  # where the file has the mesh does not count
        if isinstance(config, PlacedObjectConfig | MoverConfig):
            anchor = config.anchor
            far = FAR_M / config.scale if anchor == "origin" else 0.0
        place = (path, config.object_name)
        mesh = None if place in self._edges else self._load(place, field)
        origin = _origin_of(self._edges[place], far)
        # At all scales at which a mesh lies near its origin, it has one prototype.
        key = (*place, config.up_axis, anchor, tuple(origin.tolist()))
        if key not in self._files:
            mesh = self._load(place, field) if mesh is None else mesh
            if path.suffix.lower() == ".obj" and config.up_axis is None:
                LOG.info("%s: .obj files do not say which axis is up: z is taken (up_axis)", path)
            near_m = _near_origin(mesh, path, anchor, origin, field)
            self._files[key] = _file_prototype(mesh, _upright(near_m, path, config.up_axis), anchor)
        return self._files[key]

    def _load(self, place: tuple[Path, str | None], field: str) -> LoadedMesh:
        """Return the mesh of a file, and keep where its edges are."""
        mesh = load_mesh(*place, field)
        self._edges[place] = np.stack((mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)))
        return mesh


def _origin_of(edges: NDArray[np.floating[Any]], far: float) -> FloatArray:
    """Return the point to which a mesh's origin moves, since it lies far from its own; else 0.

    Args:
        edges: (2, 3) least and largest coordinates of the mesh.
        far: Distance from the origin that is far, in the file's units; 0: only sizes count.
    """
    origin = local_origin(edges, far)
    size = float(np.ptp(edges, axis=0).max())
    return np.where(np.abs(origin) > FAR_SIZES * size, origin, 0.0)


def _near_origin(
    mesh: LoadedMesh, path: Path, anchor: Anchor, origin: FloatArray, field: str
) -> NDArray[np.float32]:
    """Return the vertices of a mesh relative to a point of `_origin_of`."""
    if origin.any():
        size = float(np.ptp(mesh.vertices_m, axis=0).max())
        check_float32_step(mesh.float32, size * MAX_STEP_SHARE, path, field)
    if origin.any() and anchor == "origin":
        LOG.warning(
            "%s: lies far from its origin, so that of the object is at [%s] of its coordinates",
            path,
            ", ".join(f"{value:.0f}" for value in origin),
        )
    return np.asarray(mesh.vertices_m - origin, np.float32)


def _file_prototype(
    mesh: LoadedMesh, vertices_m: NDArray[np.float32], anchor: Anchor
) -> MeshPrototype:
    """Return the prototype of a file's mesh with other vertices, relative to its anchor."""
    if anchor == "base":
        vertices_m = (vertices_m - _base_of(vertices_m)).astype(np.float32)
    return MeshPrototype(
        name=mesh.name,
        vertices_m=vertices_m,
        triangles=mesh.triangles,
        color_srgb=_mean_color(mesh.vertex_colors_srgb),
        vertex_colors_srgb=mesh.vertex_colors_srgb,
        uv=mesh.uv,
        materials=mesh.materials,
        material_of=mesh.material_of,
    )


def _upright(
    vertices_m: NDArray[np.float32], path: Path, up_axis: str | None
) -> NDArray[np.float32]:
    """Return vertices rotated so that the given axis of the file points up."""
    was_turned = path.suffix.lower() in Y_UP_SUFFIXES
    if up_axis is None or was_turned == (up_axis == "y"):
        return vertices_m
    R = R_Z_UP_FROM_Y_UP.T if was_turned else R_Z_UP_FROM_Y_UP
    return (vertices_m @ R.T).astype(np.float32)


def _of_size_1(look: MeshPrototype) -> MeshPrototype:
    """Return a mesh scaled to 1 m along its longest axis, the centre of its base at the origin."""
    base, size_m = _base_of(look.vertices_m), float(np.ptp(look.vertices_m, axis=0).max())
    return replace(look, vertices_m=((look.vertices_m - base) / size_m).astype(np.float32))


def _is_of_size_1(look: MeshPrototype) -> bool:
    """Return whether a shape is 1 m large and stands at the origin, maybe with its roots below."""
    is_1_m = abs(float(np.ptp(look.vertices_m, axis=0).max()) - 1) < 1e-5
    return is_1_m and abs(float(look.vertices_m[:, 2].min())) < 0.2


def _base_of(vertices_m: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the (3,) centre of the bottom of the vertices' bounding box."""
    low, high = (np.asarray(edge, np.float64) for edge in (vertices_m.min(0), vertices_m.max(0)))
    return np.array(((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]))


def _of_one_color(look: MeshPrototype, color: tuple[float, float, float]) -> MeshPrototype:
    """Return a mesh of another, uniform colour; what is cut out of it stays so."""
    bare = replace(look, vertex_colors_srgb=None, color_image_srgb=None, color_srgb=color)
    if all(each.opacity is None for each in look.materials):
        return replace(bare, uv=None, materials=(), material_of=None)
    recolored = [replace(m, color_srgb=color, color_image_srgb=None) for m in look.materials]
    return replace(bare, materials=tuple(recolored))


def _mean_color(colors: NDArray[np.uint8] | None) -> tuple[float, float, float]:
    if colors is None:
        return (0.5, 0.5, 0.5)
    red, green, blue = colors.reshape(-1, 3).mean(axis=0) / 255
    return (float(red), float(green), float(blue))
