"""Water on a ground up to a level: its ponds, as meshes with ids of their own."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.scene import Ground, MeshPrototype, Placement, WaterSurface
from oaisys_core.types import FloatArray

CELLS = 256
"""Most cells of the surface along an edge of the stage."""

FIRST_WATER_ID, MAX_PONDS = 65_001, 500
"""Instance ids of ponds, from the largest on; all smaller ones share the last id."""

MARGIN = 1
"""Cells by which a pond's mesh goes on below the ground around it."""

Parts = tuple[tuple[MeshPrototype, ...], tuple[Placement, ...]]


@dataclass(frozen=True)
class WaterLook:
    """How water looks.

    Attributes:
        clarity_m: Depth at which two thirds of the bottom's colour are gone.
        color_srgb: Colour of deep water.
        waves: Strength of ripples, 0 to 1.
    """

    clarity_m: float
    color_srgb: tuple[float, float, float]
    waves: float


class WaterParts(NamedTuple):
    """Water as parts of a scene: one prototype and one placement for each pond, in pairs."""

    prototypes: tuple[MeshPrototype, ...]
    placements: tuple[Placement, ...]


NO_WATER = WaterParts((), ())


class _Joined(NamedTuple):
    """The last parts that were joined, of a scene and of the land, and the whole."""

    beyond: WaterParts
    prototypes: tuple[MeshPrototype, ...]
    placements: tuple[Placement, ...]
    whole: Parts


@dataclass(eq=False)
class Water:
    """The water of a world; the same for all its samples.

    Attributes:
        level_m: Height of the surface.
        semantic_ids: From level 0 on.
        look: How it looks.
        parts: The ponds of the stage.
        wet_bank_m: Height above the level up to which the ground is wet.
    """

    level_m: float
    semantic_ids: tuple[int, ...]
    look: WaterLook
    parts: WaterParts
    wet_bank_m: float
    _joined: _Joined | None = field(default=None, repr=False)

    def join(
        self,
        prototypes: tuple[MeshPrototype, ...],
        placements: tuple[Placement, ...],
        beyond: WaterParts = NO_WATER,
    ) -> Parts:
        """Return the parts of a scene with those of the water; identical ones for identical ones.

        Backends see by the identity of a scene's parts whether they changed.

        Args:
            prototypes, placements: Those of the scene without water.
            beyond: The water on the land around the stage, if that is shown.
        """
        last = self._joined
        if last is not None and last.beyond is beyond and last.prototypes is prototypes:
            if last.placements is placements:
                return last.whole
            # Only objects moved: the water's own parts are as they were.
            meshes, own = last.whole[0], last.whole[1][len(last.placements) :]
        else:
            first = len(prototypes)
            water = (*self.parts.placements, *beyond.placements)
            own = tuple(replace(each, prototype=first + i) for i, each in enumerate(water))
            meshes = (*prototypes, *self.parts.prototypes, *beyond.prototypes)
        whole = meshes, (*placements, *own)
        self._joined = _Joined(beyond, prototypes, placements, whole)
        return whole


def water_on(
    ground: Ground,
    level_m: float,
    semantic_ids: tuple[int, ...],
    look: WaterLook,
    wet_bank_m: float,
) -> Water:
    """Return the water that covers all ground below a level."""
    x_m, y_m, is_wet = _wet_cells(ground, level_m)
    ponds, count = scipy.ndimage.label(is_wet, np.ones((3, 3), bool))
    sizes = np.bincount(ponds.ravel(), minlength=count + 1)[1:]
    number_of = np.zeros(count + 1, np.int64)
    number_of[1 + np.argsort(-sizes, kind="stable")] = np.minimum(np.arange(count), MAX_PONDS - 1)
    prototypes, placements = [], []
    T = np.eye(4)
    T[2, 3] = level_m
    for number in range(min(count, MAX_PONDS)):
        cells = is_wet & (number_of[ponds] == number)
        cells = scipy.ndimage.binary_dilation(cells, np.ones((3, 3), bool), iterations=MARGIN)
        # A cell between two ponds belongs to the larger one.
        cells &= ~is_wet | (number_of[ponds] == number)
        placements.append(
            Placement(number, semantic_ids, T[None], np.array([FIRST_WATER_ID + number], np.uint32))
        )
        prototypes.append(_sheet(f"water_{number + 1}", x_m, y_m, cells, ground, level_m, look))
    parts = WaterParts(tuple(prototypes), tuple(placements))
    return Water(level_m, semantic_ids, look, parts, wet_bank_m)


def level_from_share(ground: Ground, share: float) -> float:
    """Return the height that lies by a share between the lowest and the highest point."""
    height_m = ground.vertices_m()[:, 2]
    low_m, high_m = float(np.nanmin(height_m)), float(np.nanmax(height_m))
    return low_m + share * (high_m - low_m)


def _wet_cells(ground: Ground, level_m: float) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return the borders of the columns and rows of cells, and (R, C) which have water."""
    x0, y0, x1, y1 = ground.extent_m
    long_m = max(x1 - x0, y1 - y0)
    count = int(np.clip(long_m / ground.spacing_m, 1, CELLS))
    cols, rows = (max(1, round(count * edge / long_m)) for edge in (x1 - x0, y1 - y0))
    x_m, y_m = np.linspace(x0, x1, cols + 1), np.linspace(y0, y1, rows + 1)
    vertices = ground.vertices_m()
    low = vertices[vertices[:, 2] < level_m].astype(np.float64)
    is_wet = np.zeros((rows, cols), bool)
    col = np.clip(((low[:, 0] - x0) / (x1 - x0) * cols).astype(np.intp), 0, cols - 1)
    row = np.clip(((low[:, 1] - y0) / (y1 - y0) * rows).astype(np.intp), 0, rows - 1)
    is_wet[row, col] = True
    x, y = np.meshgrid((x_m[1:] + x_m[:-1]) / 2, (y_m[1:] + y_m[:-1]) / 2)
    middle_m = ground.height_at(np.column_stack((x.ravel(), y.ravel()))).reshape(x.shape)
    return x_m, y_m, is_wet | (np.nan_to_num(middle_m, nan=np.inf) < level_m)


def _sheet(
    name: str,
    x_m: FloatArray,
    y_m: FloatArray,
    cells: NDArray[np.bool_],
    ground: Ground,
    level_m: float,
    look: WaterLook,
) -> MeshPrototype:
    """Return a level mesh of some cells, whose opacity grows with the depth."""
    used, triangles = sheet_triangles(cells)
    width = len(x_m)
    xy = np.column_stack((x_m[used % width], y_m[used // width]))
    depth_m = np.nan_to_num(level_m - ground.height_at(xy), nan=0.0)
    vertices_m = np.column_stack((xy, np.zeros(len(xy))))
    return water_mesh(name, vertices_m, triangles, depth_m, look)


def sheet_triangles(cells: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """Return the corners of (R, C) chosen cells that are used, and (T, 3) triangles of these.

    Corners are numbered row by row, C + 1 in each row.
    """
    row, col = np.nonzero(cells)
    width = cells.shape[1] + 1
    a = row * width + col
    corners = np.vstack(
        (
            np.column_stack((a, a + 1, a + width + 1)),
            np.column_stack((a, a + width + 1, a + width)),
        )
    )
    used, triangles = np.unique(corners, return_inverse=True)
    return used, triangles.reshape(-1, 3).astype(np.int32)


def water_mesh(
    name: str,
    vertices_m: FloatArray,
    triangles: NDArray[np.int32],
    depth_m: FloatArray,
    look: WaterLook,
) -> MeshPrototype:
    """Return water of (V, 3) vertices and (T, 3) triangles, by the (V,) depths below."""
    opacity = 1 - np.exp(-np.maximum(depth_m, 0.0) / look.clarity_m)
    rgb = np.rint(np.array(look.color_srgb) * 255).astype(np.uint8)
    return MeshPrototype(
        name=name,
        vertices_m=vertices_m.astype(np.float32),
        triangles=triangles,
        color_srgb=look.color_srgb,
        vertex_colors_srgb=np.broadcast_to(rgb, (len(vertices_m), 3)).copy(),
        water=WaterSurface(np.rint(opacity * 255).astype(np.uint8), look.waves),
    )
