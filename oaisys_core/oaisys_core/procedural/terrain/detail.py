"""Finer ground around the cameras, for depth, labels, colour and height queries alike.

A square patch of the grid is replaced by a finer grid: the smoothed coarse surface plus noise that
is too fine for the coarse grid, and the relief of the ground's textures. Towards the rim of the
patch they fade into the coarse triangles. The triangles just outside are split into fans that end
at the rim's points, so that there is no gap. The position of the patch depends only on the current
positions of the cameras.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, log2

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from oaisys_core import randomness
from oaisys_core.procedural.terrain.displacement import LayerRelief
from oaisys_core.procedural.terrain.noise import fractal
from oaisys_core.scene import Ground, HeightField
from oaisys_core.scene.terrain_material import STEEP_COS
from oaisys_core.types import FloatArray

FADE_SHARE = 0.35
"""Share of the patch's half edge over which it fades into the coarse ground."""

MAX_FINE_PX = 2049
"""Largest number of points along an edge of the patch; larger patches have a wider spacing."""

RELIEF_COS = (STEEP_COS[0], 0.87)
"""Vertical components of the normal (slopes of 40 and 30 degrees) between which the relief of
textures fades in, where they are projected from the side on steep slopes."""

MARGIN = 8
"""Coarse points around a patch that its smooth surface is made from."""


@dataclass(frozen=True)
class Detail:
    """The parameters of the refinement.

    Attributes:
        seed: Seed of the noise, which is fixed in ``map``.
        radius_m: Half the edge of the patch.
        spacing_m: Largest distance between its points.
        amplitude_m: Amplitude of the noise.
        gain: Amplitude of each octave relative to the coarser one.
        below_m: Height of the cameras above the ground up to which it is refined.
        textures: Factor on the relief of the ground's textures.
        relief: That relief with its factor; None for none, or until the material is drawn.
        shown: The part of it by which the coarse ground is displaced already; None for none.
    """

    seed: int
    radius_m: float
    spacing_m: float
    amplitude_m: float
    gain: float
    below_m: float
    textures: float = 0.0
    relief: LayerRelief | None = None
    shown: LayerRelief | None = None

    def around(
        self, ground: Ground, near: DetailedGround | None, positions_m: FloatArray
    ) -> DetailedGround | None:
        """Return the ground refined around (N, 3) camera positions; None if they are too high.

        The result depends only on the ground and the positions. If ``near``, the current refined
        ground, is the same, it is returned itself.
        """
        if not isinstance(ground, HeightField):
            return None
        x, y, z = np.mean(positions_m, axis=0)
        height_m = ground.height_at([(x, y)])[0]
        if not z - height_m <= self.below_m:
            return None
        patch = patch_at(ground, self, (x, y))
        if near is not None and near.coarse is ground and near.patch == patch:
            return near
        return add_detail(ground, self, patch)


@dataclass(frozen=True)
class Patch:
    """The refined cells of a grid: rows r0 to r1 and columns c0 to c1, ends excluded."""

    r0: int
    r1: int
    c0: int
    c1: int


@dataclass(frozen=True)
class DetailedGround:
    """A grid in which a finer grid replaces some cells.

    Attributes:
        coarse: The grid.
        fine: The finer grid, with `factor` cells along the edge of each coarse cell.
        patch: The cells that it replaces.
        shaded: The finer grid without the relief of textures, whose normals colour is made with,
            because maps of normals have that relief; None if there is no such relief.
    """

    coarse: HeightField
    fine: HeightField
    patch: Patch
    shaded: HeightField | None = None

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """(min_x, min_y, max_x, max_y) of the ground."""
        return self.coarse.extent_m

    @property
    def spacing_m(self) -> float:
        """Distance between points of the coarse grid."""
        return self.coarse.spacing_m

    @property
    def tag(self) -> str:
        """A text that differs between refinements of the same ground."""
        p = self.patch
        return f"+{p.r0}:{p.r1},{p.c0}:{p.c1}"

    @property
    def factor(self) -> int:
        """Fine cells along the edge of a coarse one."""
        return (self.fine.elevation_m.shape[0] - 1) // (self.patch.r1 - self.patch.r0)

    def vertices_m(self) -> NDArray[np.float32]:
        """Return (V, 3) float32 vertices: the remaining coarse ones, then the fine ones."""
        return self._mesh[0]

    def triangles(self) -> NDArray[np.int32]:
        """Return (T, 3) int32 indices, counter-clockwise from above."""
        return self._mesh[1]

    def shading_normals(self) -> NDArray[np.float32] | None:
        """Return (V, 3) float32 unit normals of the vertices for colour; None for the mesh's."""
        if self.shaded is None:
            return None
        grids = (self.coarse, self.shaded)
        normals = np.concatenate([grid_normals(each).reshape(-1, 3) for each in grids])
        return np.asarray(normals[self._used])

    def height_at(self, xy_m: ArrayLike) -> FloatArray:
        """Return (N,) heights of the surface at (N, 2) points; NaN outside it."""
        fine_m = self.fine.height_at(xy_m)
        return np.where(np.isfinite(fine_m), fine_m, self.coarse.height_at(xy_m))

    @cached_property
    def _mesh(self) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        used = self._used
        vertices = np.concatenate((self.coarse.vertices_m(), self.fine.vertices_m()))[used]
        return vertices, (np.cumsum(used, dtype=np.int32) - 1)[self._corners]

    @cached_property
    def _used(self) -> NDArray[np.bool_]:
        """Which points of both grids, the coarse ones first, the mesh has."""
        used = np.zeros(self.coarse.elevation_m.size + self.fine.elevation_m.size, np.bool_)
        used[self._corners] = True
        return used

    @cached_property
    def _corners(self) -> NDArray[np.int32]:
        """Corners of the (T, 3) triangles among the points of both grids."""
        rows, cols = self.coarse.elevation_m.shape
        coarse = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
        p, k = self.patch, self.factor
        height, width = self.fine.elevation_m.shape
        fine = (rows * cols + np.arange(height * width, dtype=np.int32)).reshape(height, width)
        triangles = np.concatenate(
            (self._outside(coarse), _fans(coarse, fine, p, k), _cells(fine).reshape(-1, 3))
        )
        # Replace the coarse points on the rim by fine ones; those inside are not used.
        same = np.arange(rows * cols + height * width, dtype=np.int32)
        same[coarse[p.r0 : p.r1 + 1, p.c0 : p.c1 + 1]] = fine[::k, ::k]
        return np.asarray(same[triangles])

    def _outside(self, coarse: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the coarse triangles that do not change."""
        p = self.patch
        stays = np.ones((coarse.shape[0] - 1, coarse.shape[1] - 1, 2), np.bool_)
        stays[p.r0 : p.r1, p.c0 : p.c1] = False
        # Index 0 is the triangle at the lower edge (towards +x), 1 the one at the upper edge.
        if p.r0:
            stays[p.r0 - 1, p.c0 : p.c1, 1] = False
        if p.c0:
            stays[p.r0 : p.r1, p.c0 - 1, 0] = False
        stays[p.r1 : p.r1 + 1, p.c0 : p.c1, 0] = False
        stays[p.r0 : p.r1, p.c1 : p.c1 + 1, 1] = False
        return _cells(coarse)[stays]


def patch_at(ground: HeightField, detail: Detail, xy_m: ArrayLike) -> Patch:
    """Return the patch around (2,) ``xy_m``, within the grid.

    Its centre moves in steps of half a radius, so that small motions do not change it.
    """
    rows, cols = ground.elevation_m.shape
    half = max(1, ceil(detail.radius_m / ground.spacing_m))
    step = max(1, half // 2)
    column, row = (np.asarray(xy_m, np.float64) - ground.origin_xy_m) / ground.spacing_m
    centre = [round(float(x) / step) * step for x in (row, column)]
    bounds = []
    for at, cells in zip(centre, (rows - 1, cols - 1), strict=True):
        first = min(max(at - half, 0), max(cells - 2 * half, 0))
        bounds.append((first, min(first + 2 * half, cells)))
    return Patch(*bounds[0], *bounds[1])


def add_detail(ground: HeightField, detail: Detail, patch: Patch) -> DetailedGround:
    """Return the ground with one patch of it refined."""
    cells = max(patch.r1 - patch.r0, patch.c1 - patch.c0)
    factor = max(2, ceil(ground.spacing_m / detail.spacing_m - 1e-6))
    factor = max(2, min(factor, (MAX_FINE_PX - 1) // cells))
    x0, y0 = ground.origin_xy_m
    spacing_m = ground.spacing_m / factor
    shape = ((patch.r1 - patch.r0) * factor + 1, (patch.c1 - patch.c0) * factor + 1)
    row = patch.r0 + np.arange(shape[0]) / factor
    column = patch.c0 + np.arange(shape[1]) / factor
    flat_m = _on_triangles(ground, row, column)
    base = ground if detail.shown is None else _lowered(ground, detail.shown, patch)
    smooth_m = _smooth(base, row, column)
    rows, cols = ground.elevation_m.shape
    fade = np.minimum(
        _fade(row, patch.r0, patch.r1, rows - 1)[:, None],
        _fade(column, patch.c0, patch.c1, cols - 1),
    )
    x, y = column[None, :] * ground.spacing_m, row[:, None] * ground.spacing_m
    noise_m = detail.amplitude_m * _noise(x, y, detail, ground.spacing_m, spacing_m)
    plain_m = flat_m + fade * (smooth_m - flat_m + noise_m)
    origin_m = (x0 + patch.c0 * ground.spacing_m, y0 + patch.r0 * ground.spacing_m)
    fine = HeightField(plain_m.astype(np.float32), origin_m, spacing_m)
    if detail.relief is None:
        return DetailedGround(ground, fine, patch)
    relief_m = fade * detail.relief.on_grid(fine)
    if detail.relief.material.projects_sides:
        relief_m *= _smoothstep((grid_normals(fine)[..., 2] - RELIEF_COS[0]) / np.ptp(RELIEF_COS))
    raised = replace(fine, elevation_m=(plain_m + relief_m).astype(np.float32))
    return DetailedGround(ground, raised, patch, shaded=fine)


def _lowered(ground: HeightField, shown: LayerRelief, patch: Patch) -> HeightField:
    """Return the ground before a relief displaced it, at the points that the patch is made from."""
    r0, c0 = max(patch.r0 - MARGIN, 0), max(patch.c0 - MARGIN, 0)
    window = np.s_[r0 : patch.r1 + MARGIN + 1, c0 : patch.c1 + MARGIN + 1]
    x0, y0 = ground.origin_xy_m
    origin_m = (x0 + c0 * ground.spacing_m, y0 + r0 * ground.spacing_m)
    part = replace(ground, elevation_m=ground.elevation_m[window], origin_xy_m=origin_m)
    elevation_m = ground.elevation_m.copy()
    elevation_m[window] -= shown.on_grid(part).astype(np.float32)
    return replace(ground, elevation_m=elevation_m)


def grid_normals(ground: HeightField) -> NDArray[np.float32]:
    """Return the (rows, columns, 3) unit normals of a grid's points, from those beside them."""
    along_x, along_y = np.moveaxis(ground.slopes(), -1, 0)
    upward = 1 / np.sqrt(1 + along_x**2 + along_y**2)
    normals = np.stack((-along_x * upward, -along_y * upward, upward), axis=-1)
    return np.asarray(normals, np.float32)


def _noise(
    x_m: FloatArray, y_m: FloatArray, detail: Detail, coarse_m: float, fine_m: float
) -> FloatArray:
    """Return noise with all wavelengths that the coarse grid cannot represent."""
    longest_m = max(4 * coarse_m, 8 * fine_m)
    octaves = max(1, round(log2(longest_m / (4 * fine_m))))
    rng = randomness.stream(detail.seed, "stage.detail")
    x, y = x_m / longest_m, y_m / longest_m
    return fractal(x, y, rng, octaves=octaves, gain=detail.gain).astype(np.float64)


def _on_triangles(ground: HeightField, row: FloatArray, column: FloatArray) -> FloatArray:
    """Return the heights of the coarse triangles at rows and columns of the grid."""
    z = ground.elevation_m.astype(np.float64)
    r = np.minimum(row.astype(np.intp), z.shape[0] - 2)
    c = np.minimum(column.astype(np.intp), z.shape[1] - 2)
    t, s = (row - r)[:, None], (column - c)[None, :]
    z00, z10 = z[np.ix_(r, c)], z[np.ix_(r, c + 1)]
    z01, z11 = z[np.ix_(r + 1, c)], z[np.ix_(r + 1, c + 1)]
    lower = z00 + s * (z10 - z00) + t * (z11 - z10)
    upper = z00 + t * (z01 - z00) + s * (z11 - z01)
    return np.where(s >= t, lower, upper)


def _smooth(ground: HeightField, row: FloatArray, column: FloatArray) -> FloatArray:
    """Return the heights of a smooth surface through the grid's points."""
    r0, c0 = max(int(row[0]) - MARGIN, 0), max(int(column[0]) - MARGIN, 0)
    window = ground.elevation_m[r0 : int(row[-1]) + MARGIN + 1, c0 : int(column[-1]) + MARGIN + 1]
    places = np.meshgrid(row - r0, column - c0, indexing="ij")
    heights = scipy.ndimage.map_coordinates(
        window.astype(np.float64), places, order=3, mode="nearest"
    )
    return np.asarray(heights)


def _fade(at: FloatArray, first: int, last: int, end: int) -> FloatArray:
    """Return weights of 0 at the ends of a patch and 1 inside; no fade at the edges of the grid."""
    width = FADE_SHARE * (last - first) / 2
    low = np.ones_like(at) if first == 0 else np.clip((at - first) / width, 0, 1)
    high = np.ones_like(at) if last == end else np.clip((last - at) / width, 0, 1)
    return _smoothstep(np.minimum(low, high))


def _smoothstep(share: FloatArray) -> FloatArray:
    """Return a smooth transition from 0 to 1 over shares from 0 to 1."""
    inside = np.clip(share, 0, 1)
    return np.asarray(inside * inside * (3 - 2 * inside))


def _cells(index: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return (rows - 1, cols - 1, 2, 3) triangles of a grid, cut as `HeightField` does."""
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    return np.stack((np.stack((a, b, c), -1), np.stack((a, c, d), -1)), axis=2)


def _fans(
    coarse: NDArray[np.int32], fine: NDArray[np.int32], p: Patch, factor: int
) -> NDArray[np.int32]:
    """Return the triangles between the fine edges of the rim and the coarse points outside."""
    fans = [np.empty((0, 3), np.int32)]

    def add(tip: NDArray[np.int32], first: NDArray[np.int32], second: NDArray[np.int32]) -> None:
        fans.append(np.column_stack((np.repeat(tip, factor), first, second)))

    if p.r0:
        add(coarse[p.r0 - 1, p.c0 : p.c1], fine[0, 1:], fine[0, :-1])
    if p.r1 < coarse.shape[0] - 1:
        add(coarse[p.r1 + 1, p.c0 + 1 : p.c1 + 1], fine[-1, :-1], fine[-1, 1:])
    if p.c0:
        add(coarse[p.r0 : p.r1, p.c0 - 1], fine[:-1, 0], fine[1:, 0])
    if p.c1 < coarse.shape[1] - 1:
        add(coarse[p.r0 + 1 : p.r1 + 1, p.c1 + 1], fine[1:, -1], fine[:-1, -1])
    return np.concatenate(fans)
