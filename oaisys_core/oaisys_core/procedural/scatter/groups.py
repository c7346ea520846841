"""Sizes and poses of the instances of a group."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.config.sections.groups import GroupConfig
from oaisys_core.procedural.scatter.placement.density import Density, in_clumps, make_density
from oaisys_core.procedural.scatter.placement.ground_pose import footprint_of
from oaisys_core.procedural.scatter.placement.random_poses import (
    MAX_TILT_DEG,
    bedding,
    leaning,
    poses_with_scale,
    power_law_sizes,
    slope_deg,
)
from oaisys_core.procedural.scatter.placement.resting import (
    MAX_BURIED,
    resting_depth_m,
    sunk_shares,
)
from oaisys_core.procedural.scatter.placement.spacing import (
    OccupiedPlaces,
    Spacing,
    first_come,
    pairs_too_near,
)
from oaisys_core.procedural.scatter.plants.organ_sizes import CLASS_RATIO
from oaisys_core.procedural.scatter.rocks import ROCK_KINDS
from oaisys_core.procedural.scatter.shapes import MATS, PLANTS
from oaisys_core.scene import Ground, MeshPrototype
from oaisys_core.scene.terrain_material import TerrainMaterial
from oaisys_core.types import FloatArray

ROUNDS = 24
"""Rounds of drawing positions before fewer instances are accepted."""

MAX_DRAWN = 400_000
"""Largest number of positions drawn at once."""

SPARE = 64
"""Positions drawn in addition to the expected number."""

SPARSEST = 1 / 64
"""Least acceptance rate that is compensated by drawing more positions at once."""

CELLS = 512
"""Cells along an edge of the ground; none is used where the density is 0 in and around it."""

FULL = 0.01
"""Share of the missing instances that a round must place; below it, the ground is full."""


MAX_CLASSES = 16
"""Largest number of size classes of a group; beyond sizes of 1 to 600, leaves vary more."""


WADING_M = {"reed": 1.0, "sedge": 0.3, "willow": 0.2}
"""Depths of water in which plants stand; others stand on dry ground alone."""


class GroundAlignment(NamedTuple):
    """How objects stand, see `GroupConfig`."""

    tilt_deg: float
    align: float
    sink: tuple[float, float]


RESTING = GroundAlignment(tilt_deg=MAX_TILT_DEG, align=1.0, sink=(0.1, 0.6))
LYING = GroundAlignment(tilt_deg=MAX_TILT_DEG, align=1.0, sink=(0.15, 0.4))
ROOTED = GroundAlignment(tilt_deg=4.0, align=0.2, sink=(0.0, 0.03))
SPREAD = GroundAlignment(tilt_deg=0.0, align=1.0, sink=(0.0, 0.03))
"""Of built-in rocks, of whatever else may lie anyhow, of plants, and of plants that are wider than
high."""


def ground_alignment(group: GroupConfig) -> GroundAlignment:
    """Return how a group's objects stand: as given, or as is usual for their shape."""
    usual = ROOTED if group.shape in PLANTS else LYING
    if group.shape in ROCK_KINDS:
        usual = RESTING
    if group.shape in MATS:
        usual = SPREAD
    return GroundAlignment(
        usual.tilt_deg if group.tilt_deg is None else group.tilt_deg,
        usual.align if group.align is None else group.align,
        usual.sink if group.sink is None else group.sink,
    )


def scatter_group(
    group: GroupConfig,
    count: int,
    shapes: list[MeshPrototype],
    ground: Ground,
    rng: np.random.Generator,
    material: TerrainMaterial | None = None,
    water_m: float | None = None,
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the poses of up to ``count`` instances of a group, largest first.

    Args:
        shapes: Its prototypes, each 1 m large: as many for each of `size_classes_m`, in its order.
        ground: What they stand on.
        rng: Seeds the separate streams of positions, sizes and rotations.
        material: Of the ground; None if there is none, nor a density of a layer.
        water_m: Level of the water, in which few plants stand (`WADING_M`).

    Returns:
        (N, 4, 4) rotation times uniform scale with translation, and (N,) indices into ``shapes``.

    Raises:
        ConfigError: A density's image cannot be read.
    """
    sizes_m = group_sizes_m(group, count, randomness.child(rng, "sizes"))
    shape_of = _shapes_of(group, sizes_m, len(shapes), randomness.child(rng, "shapes"))
    density = make_density(group.density, ground, rng, material)
    if water_m is not None and group.shape in PLANTS:
        density = _out_of_water(density, ground, water_m - WADING_M.get(group.shape, 0.0))
    if group.shape in PLANTS and group.shape not in MATS and not group.spacing_m:
        size_m = float(np.sqrt(group.size_m[0] * group.size_m[1]))
        density = in_clumps(density, size_m, ground, randomness.child(rng, "clumps"))
    xy = _places(group, sizes_m, density, ground, randomness.child(rng, "places"))
    stands = np.isfinite(xy[:, 0])
    xy, sizes_m, shape_of = xy[stands], sizes_m[stands], shape_of[stands]
    turns = randomness.child(rng, "turns")
    return poses_at(group, ground, xy, sizes_m, shapes, shape_of, turns), shape_of


def _out_of_water(density: Density, ground: Ground, least_m: float) -> Density:
    """Return a density that is 0 where the ground is lower than a height."""
    return lambda xy: np.where(ground.height_at(xy) >= least_m, density(xy), 0.0)


def size_classes_m(group: GroupConfig) -> FloatArray:
    """Return the (C,) middles of the size classes of a group, whose instances share meshes.

    Leaves have sizes of their own, so that plants share a mesh only with plants up to
    `CLASS_RATIO` times as large; everything else has one class.
    """
    low, high = group.size_m
    if group.shape not in PLANTS:
        return np.array([float(np.sqrt(low * high))])
    span = np.log(high / low)
    count = int(np.clip(np.ceil(span / np.log(CLASS_RATIO) - 1e-9), 1, MAX_CLASSES))
    return np.asarray(low * np.exp((np.arange(count) + 0.5) / count * span))


def _shapes_of(
    group: GroupConfig, sizes_m: FloatArray, shape_count: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Return the (count,) shapes of instances with (count,) sizes: one of their size class."""
    middles_m = size_classes_m(group)
    if shape_count % len(middles_m):
        return rng.integers(shape_count, size=len(sizes_m))
    variants = shape_count // len(middles_m)
    borders_m = np.sqrt(middles_m[1:] * middles_m[:-1])
    return np.searchsorted(borders_m, sizes_m) * variants + rng.integers(
        variants, size=len(sizes_m)
    )


def group_sizes_m(group: GroupConfig, count: int, rng: np.random.Generator) -> FloatArray:
    """Return (count,) sizes of a group's instances, within its range, largest first."""
    low, high = group.size_m
    if low == high:
        return np.full(count, low)
    if group.size_distribution == "power_law":
        sizes_m = power_law_sizes(count, group.size_m, group.size_exponent, rng)
    elif group.size_distribution == "uniform":
        sizes_m = rng.uniform(low, high, count)
    else:
        mean_m = (low + high) / 2 if group.size_mean_m is None else group.size_mean_m
        std_m = (high - low) / 4 if group.size_std_m is None else group.size_std_m
        bounds = scipy.stats.truncnorm(
            (low - mean_m) / std_m, (high - mean_m) / std_m, mean_m, std_m
        )
        sizes_m = bounds.ppf(rng.uniform(size=count))
    return np.sort(np.clip(sizes_m, low, high))[::-1]


def _places(
    group: GroupConfig,
    sizes_m: FloatArray,
    density: Density,
    ground: Ground,
    rng: np.random.Generator,
) -> FloatArray:
    """Return (N, 2) positions of instances with (N,) decreasing sizes; NaN if there was no room."""
    spacing = Spacing(group.spacing, group.spacing_m)
    taken = OccupiedPlaces(spacing)
    xy = np.full((len(sizes_m), 2), np.nan)
    sampler = _PlaceSampler(group, density, ground, rng)
    # By octaves of size: large ones find room first, and fewer pairs are compared.
    octave = np.floor(np.log2(sizes_m[0] / sizes_m + 1e-9)) if len(sizes_m) else sizes_m
    for start, stop in _runs(octave):
        missing = np.arange(start, stop)
        for _ in range(ROUNDS):
            drawn = sampler.draw(len(missing))
            slots = missing[: len(drawn)]
            fits = taken.free(drawn, sizes_m[slots])
            drawn, slots = drawn[fits], slots[fits]
            fits = first_come(len(drawn), pairs_too_near(drawn, sizes_m[slots], spacing))
            xy[slots[fits]] = drawn[fits]
            taken.add(drawn[fits], sizes_m[slots[fits]])
            enough = int(FULL * len(missing))
            missing = np.setdiff1d(missing, slots[fits], assume_unique=True)
            if not len(missing) or fits.sum() < enough:
                break
    return xy


class _PlaceSampler:
    """Draws positions according to a group's densities, on ground that is not too steep."""

    def __init__(
        self, group: GroupConfig, density: Density, ground: Ground, rng: np.random.Generator
    ) -> None:
        self._density, self._ground, self._rng = density, ground, rng
        self._max_slope_deg = group.max_slope_deg
        x0, y0, x1, y1 = ground.extent_m
        margin_m = min(group.size_m[1] / 2, (x1 - x0) / 4, (y1 - y0) / 4)
        self._low = np.array((x0, y0)) + margin_m
        self._cell = (np.array((x1, y1)) - margin_m - self._low) / CELLS
        self._cells = self._possible_cells() if group.density else None
        self._share = 1.0

    def draw(self, count: int) -> FloatArray:
        """Return (N, 2) positions: at most ``count``, fewer if many of those drawn are rejected."""
        number = min(MAX_DRAWN, int(np.ceil(count / max(self._share, SPARSEST))) + SPARE)
        drawn = self._anywhere(number)
        drawn = drawn[self._rng.uniform(size=len(drawn)) < self._density(drawn)]
        drawn = drawn[slope_deg(self._ground, drawn) <= self._max_slope_deg]
        self._share = max(self._share / 4, len(drawn) / max(number, 1))
        return drawn[:count]

    def _anywhere(self, number: int) -> FloatArray:
        """Return up to (number, 2) positions in cells with a positive density."""
        if self._cells is None:
            span = self._cell * CELLS
            return np.asarray(self._low + self._rng.uniform(size=(number, 2)) * span)
        if not len(self._cells):
            return np.zeros((0, 2))
        chosen = self._cells[self._rng.integers(len(self._cells), size=number)]
        within = self._rng.uniform(size=(number, 2))
        return np.asarray(self._low + (chosen + within) * self._cell)

    def _possible_cells(self) -> NDArray[np.intp]:
        """Return (C, 2) columns and rows of cells with a positive density in or next to them."""
        index = np.arange(CELLS)
        columns, rows = np.meshgrid(index, index)
        cells = np.column_stack((columns.ravel(), rows.ravel()))
        likely = self._density(self._low + (cells + 0.5) * self._cell) > 0
        near = scipy.ndimage.binary_dilation(likely.reshape(CELLS, CELLS), np.ones((3, 3), bool))
        return np.asarray(cells[near.ravel()])


def _runs(values: FloatArray) -> list[tuple[int, int]]:
    """Return (start, stop) of the runs of equal values."""
    borders = np.flatnonzero(np.diff(values)) + 1
    edges = [0, *borders.tolist(), len(values)]
    return [(a, b) for a, b in pairwise(edges) if a < b]


def poses_at(
    group: GroupConfig,
    ground: Ground,
    xy: FloatArray,
    sizes_m: FloatArray,
    shapes: list[MeshPrototype],
    shape_of: NDArray[np.int64],
    rng: np.random.Generator,
) -> FloatArray:
    """Return (N, 4, 4) poses with scale of a group's instances at (N, 2) places on a ground.

    Args:
        group: How they stand.
        ground: What they stand on.
        xy: The places.
        sizes_m: (N,) sizes.
        shapes: Its prototypes, each 1 m large.
        shape_of: (N,) indices into them.
        rng: Draws headings, tilts and depths.
    """
    from scipy.spatial.transform import Rotation

    count = len(xy)
    stance = ground_alignment(group)
    is_rock = group.shape in ROCK_KINDS
    yaw_rad = np.radians(rng.uniform(*group.yaw_deg, count))
    tilt_rad = np.radians(stance.tilt_deg) * rng.uniform(-1, 1, (count, 2))
    sink = sunk_shares(stance.sink, count, rng) if is_rock else rng.uniform(*stance.sink, count)
    if not count:
        return np.zeros((0, 4, 4))
    footprints = np.array([footprint_of(shape) for shape in shapes])[shape_of]
    height_m, foot_m = footprints.T * sizes_m
    slope, hollow_m = bedding(ground, xy, np.maximum(foot_m, ground.spacing_m / 2))
    tilted = Rotation.from_euler("zyx", np.column_stack((yaw_rad, tilt_rad)))
    rotation = leaning(slope, stance.align) * tilted
    if is_rock:
        as_it_lies = leaning(slope, stance.align - 1) * tilted
        depth_m = resting_depth_m(as_it_lies, sizes_m, sink, hollow_m, shapes, shape_of)
    else:
        # Leaning away from the ground's normal lifts one side of the foot, so sink it deeper.
        lean = np.linalg.norm(tilt_rad, axis=1)
        lean += (1 - stance.align) * np.arctan(np.linalg.norm(slope, axis=1))
        depth_m = sink * height_m + foot_m * np.tan(np.minimum(lean, 1.2)) + hollow_m
        # The whole base must be below the ground, unless it is level with the ground.
        depth_m = np.minimum(depth_m, MAX_BURIED * height_m)
    return poses_with_scale(rotation, sizes_m, xy, ground.height_at(xy) - depth_m)
