"""Random poses on the ground: spaced apart, not too steep, and sunk in so that nothing floats."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.scatter.placement.resting import resting_depth_m, sunk_shares
from oaisys_core.procedural.scatter.placement.spacing import Spacing, first_come, pairs_too_near
from oaisys_core.procedural.terrain.noise import Field, band
from oaisys_core.scene import Ground, MeshPrototype
from oaisys_core.types import FloatArray

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

ROUNDS = 16
"""Rounds of drawing positions before fewer objects are accepted."""

SPARE = 6
"""Places drawn for each that is missing."""

MAX_TILT_DEG = 18.0
"""Largest tilt of things of `TILT_SIZE_M` away from the ground's normal, unless said otherwise."""

TILT_SIZE_M, TILT_FACTORS = 0.5, (0.5, 1.6)
"""Size at which things tilt as much as they may, and least and largest factor of other sizes: large
ones come to rest on a wide side, small ones anyhow."""

SOURCES = 0.1
"""Share of the things, the largest, beside which others lie as their fragments."""

BESIDE, CLEAR = 1.1, 0.45
"""Standard deviation, along either axis, of the distance of a fragment from its source, and how
much farther it is for the source's own width; both in units of the source's size."""

ALIGNED_SLOPE, ALIGNED = (0.1, 0.55), 0.3
"""Slopes from which things begin to lie along the slope, and from which their bearings spread by
this share of a half turn only: what slides turns its long side downhill."""

BURYING_SLOPE, BURIED = 0.25, 2.0
"""Slope from which on things are sunk deeper, and how much more for a slope of 1."""

PATCH_M, PATCHES_PX = (1.5, 24.0), 256
"""Least and largest width of the patches of higher density, and size of the map of patches."""

CLUMPED, DENSEST = 2.0, 1.5
"""By how much the logarithm of that density differs, at full clumping, for a standard deviation of
the map, and the one from which on nothing lies denser."""


def power_law_sizes(
    count: int, size_range_m: tuple[float, float], exponent: float, rng: np.random.Generator
) -> FloatArray:
    """Return (count,) sizes from a power law: the number above size D goes as D**-exponent.

    They are drawn by inverse transform from a truncated Pareto distribution, as commonly used for
    rock abundance on Mars and the Moon (Golombek and Rapp, JGR 102(E2), 1997).
    """
    low, high = size_range_m
    u = rng.uniform(size=count)
    tail = (low / high) ** exponent
    return np.asarray(low * (1 - u * (1 - tail)) ** (-1 / exponent))


def scatter_on(
    ground: Ground,
    sizes_m: FloatArray,
    rng: np.random.Generator,
    *,
    min_spacing: float = 0.5,
    sink: tuple[float, float] = (0.15, 0.4),
    max_slope_deg: float = 40.0,
    max_tilt_deg: float = MAX_TILT_DEG,
    clumping: float = 0.7,
    fragments: float = 0.0,
    shapes: Sequence[MeshPrototype] = (),
    preference: Callable[[FloatArray], FloatArray] | None = None,
) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Return the poses of objects on the ground, fewer than there are sizes if there is no room.

    Args:
        ground: The ground.
        sizes_m: (M,) wanted sizes along the longest axis.
        rng: Draws positions and orientations.
        min_spacing: Least distance between two objects, in units of their mean size.
        sink: Range of the share of an object's height below the ground, see `sunk_shares`; more if
            the ground is hollow or steep.
        max_slope_deg: Steepest ground that is used.
        max_tilt_deg: Largest tilt away from the ground's normal, about either axis, at
            `TILT_SIZE_M`.
        clumping: 0 for an even spread; with 1 some patches are almost empty.
        fragments: Share of the objects that are drawn beside one of the largest, where they broke
            off: the more, the larger its area is.
        shapes: Of the objects, 1 m large; without any they are balls.
        preference: Density at (N, 2) points, 0 to 1; None is 1 everywhere.

    Returns:
        (N, 4, 4) rotation times uniform scale with translation, (N,) sizes in metres, largest
        first, and (N,) indices into ``shapes``.
    """
    sizes_m = np.sort(sizes_m)[::-1]
    density = _patches(ground, CLUMPED * clumping, rng)
    margin_m = rim_m(ground, sizes_m)

    def draw(count: int, sources: FloatArray) -> FloatArray:
        """Return up to (count, 2) places that the ground, patches and preference allow."""
        number = SPARE * count
        drawn = random_places(ground, number, margin_m, rng)
        if len(sources):
            is_fragment = rng.uniform(size=number) < fragments
            beside = _beside(sources, sizes_m[: len(sources)], number, rng)
            drawn[is_fragment] = beside[is_fragment]
        drawn = drawn[slope_deg(ground, drawn) <= max_slope_deg]
        likely = _nearest(density, ground, drawn)
        if preference is not None:
            likely = likely * preference(drawn)
        return drawn[rng.uniform(size=len(drawn)) < likely][:count]

    xy = np.zeros((0, 2))
    first = round(SOURCES * len(sizes_m)) if fragments else 0
    for wanted in (first, len(sizes_m)):
        sources = xy
        for _ in range(ROUNDS):
            missing = wanted - len(xy)
            if missing == 0:
                break
            drawn = draw(missing, sources)
            xy = _keep_apart(np.vstack((xy, drawn)), sizes_m, min_spacing)
    sizes_m = sizes_m[: len(xy)]
    shape_of = rng.integers(max(len(shapes), 1), size=len(xy))
    poses = poses_on(ground, xy, sizes_m, rng, sink, shapes, shape_of, max_tilt_deg)
    return poses, sizes_m, shape_of


def _beside(
    sources: FloatArray, sizes_m: FloatArray, count: int, rng: np.random.Generator
) -> FloatArray:
    """Return (count, 2) places beside (S, 2) sources with (S,) sizes."""
    area = np.cumsum(sizes_m**2)
    chosen = np.searchsorted(area, rng.uniform(size=count) * area[-1], side="right")
    chosen = np.minimum(chosen, len(sources) - 1)
    away = rng.normal(size=(count, 2)) * BESIDE
    length = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6)
    return np.asarray(sources[chosen] + away * (1 + CLEAR / length) * sizes_m[chosen, None])


def _patches(ground: Ground, clumped: float, rng: np.random.Generator) -> Field:
    """Return a density, up to 1, of patches of the sizes of `PATCH_M`."""
    x0, _, x1, _ = ground.extent_m
    highest, lowest = (max((x1 - x0) / (2 * each), 1.0) for each in PATCH_M)
    return log_gaussian(PATCHES_PX, lowest, highest, clumped, DENSEST, rng)


def log_gaussian(
    size_px: int,
    lowest: float,
    highest: float,
    clumped: float,
    densest: float,
    rng: np.random.Generator,
) -> Field:
    """Return a (size_px, size_px) density, up to 1, whose logarithm is normally distributed.

    So do things lie of which one brings others (Moller, Syversveen and Waagepetersen, "Log Gaussian
    Cox processes", Scand. J. Statist. 25, 1998).

    Args:
        size_px: Edge length.
        lowest, highest: Frequencies, in waves per edge, between which there are clumps.
        clumped: Standard deviation of the logarithm.
        densest: Where it ends, in the same.
        rng: Draws the clumps.
    """
    noise = band(size_px, lowest, max(highest, 2 * lowest), rng)
    return np.asarray(np.exp(clumped * (np.minimum(noise, densest) - densest)))


def _nearest(field: Field, ground: Ground, xy: FloatArray) -> FloatArray:
    """Return (N,) nearest values of a square field over the ground at (N, 2) points."""
    x0, y0, x1, y1 = ground.extent_m
    share = (xy - (x0, y0)) / (x1 - x0, y1 - y0)
    column, row = np.minimum((share * len(field)).astype(np.intp), len(field) - 1).T
    return np.asarray(field[row, column])


def rim_m(ground: Ground, sizes_m: FloatArray) -> float:
    """Return how far from the rim of a ground things of (N,) sizes lie, if there is room."""
    x0, y0, x1, y1 = ground.extent_m
    return min(float(sizes_m.max(initial=0.0)), (x1 - x0) / 4, (y1 - y0) / 4)


def random_places(
    ground: Ground, count: int, margin_m: float, rng: np.random.Generator
) -> FloatArray:
    """Return (count, 2) positions on the ground, ``margin_m`` from its rim."""
    x0, y0, x1, y1 = ground.extent_m
    low = (x0 + margin_m, y0 + margin_m)
    high = (x1 - margin_m, y1 - margin_m)
    return np.asarray(rng.uniform(low, high, (count, 2)))


def slope_deg(ground: Ground, xy: FloatArray) -> FloatArray:
    """Return (N,) slopes of the ground at (N, 2) points; 90 at its rim."""
    step_m = ground.spacing_m
    slope = np.degrees(np.arctan(np.hypot(*rises_m(ground, xy, step_m)) / (2 * step_m)))
    return np.asarray(np.nan_to_num(slope, nan=90.0))


def rises_m(ground: Ground, xy: FloatArray, step_m: float) -> tuple[FloatArray, FloatArray]:
    """Return (N,) rises of the ground along x and along y, each from a step before to one after.

    NaN at the rim.
    """
    east, north = np.array((step_m, 0.0)), np.array((0.0, step_m))
    rise_x_m, rise_y_m = (
        ground.height_at(xy + way) - ground.height_at(xy - way) for way in (east, north)
    )
    return rise_x_m, rise_y_m


def _keep_apart(xy: FloatArray, sizes_m: FloatArray, min_spacing: float) -> FloatArray:
    """Return the positions without those too close to an earlier one."""
    pairs = pairs_too_near(xy, sizes_m[: len(xy)], Spacing(min_spacing))
    return np.asarray(xy[first_come(len(xy), pairs)])


def poses_on(
    ground: Ground,
    xy: FloatArray,
    sizes_m: FloatArray,
    rng: np.random.Generator,
    sink: tuple[float, float],
    shapes: Sequence[MeshPrototype],
    shape_of: NDArray[np.int64],
    max_tilt_deg: float = MAX_TILT_DEG,
) -> FloatArray:
    """Return (N, 4, 4) poses with scale of things at (N, 2) places; see `scatter_on`."""
    from scipy.spatial.transform import Rotation

    count = len(xy)
    yaw_rad = rng.uniform(-np.pi, np.pi, count)
    factor = np.clip(np.sqrt(TILT_SIZE_M / np.maximum(sizes_m, 1e-6)), *TILT_FACTORS)
    tilt_rad = np.radians(max_tilt_deg) * factor[:, None] * rng.uniform(-1, 1, (count, 2))
    sunk = sunk_shares(sink, count, rng)
    if not count:
        return np.zeros((0, 4, 4))
    slope, hollow_m = bedding(ground, xy, sizes_m / 2)
    # Debris gathers above what lies on a slope.
    steep = np.maximum(np.linalg.norm(slope, axis=1) - BURYING_SLOPE, 0.0)
    sunk *= 1 + BURIED * steep
    yaw_rad = _along_slope(yaw_rad, slope)
    rotation = Rotation.from_euler("zyx", np.column_stack((yaw_rad, tilt_rad)))
    depth_m = resting_depth_m(rotation, sizes_m, sunk, hollow_m, shapes, shape_of)
    rotation = leaning(slope) * rotation
    return poses_with_scale(rotation, sizes_m, xy, ground.height_at(xy) - depth_m)


def poses_with_scale(
    rotation: Rotation, sizes_m: FloatArray, xy: FloatArray, base_m: FloatArray
) -> FloatArray:
    """Return (N, 4, 4) rotations times (N,) sizes, at (N, 2) places and (N,) heights."""
    T_map_object = np.tile(np.eye(4), (len(xy), 1, 1))
    T_map_object[:, :3, :3] = rotation.as_matrix() * sizes_m[:, None, None]
    T_map_object[:, :2, 3] = xy
    T_map_object[:, 2, 3] = base_m
    return T_map_object


def _along_slope(yaw_rad: FloatArray, slope: FloatArray) -> FloatArray:
    """Return (N,) random bearings, those on steep ground closer to the direction of the slope."""
    low, high = ALIGNED_SLOPE
    steep = np.clip((np.linalg.norm(slope, axis=1) - low) / (high - low), 0, 1)
    downhill_rad = np.arctan2(-slope[:, 1], -slope[:, 0])
    return np.asarray(yaw_rad * (1 - (1 - ALIGNED) * steep) + downhill_rad * steep)


def bedding(ground: Ground, xy: FloatArray, radius_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the plane that each object lies on.

    Returns:
        (N, 2) slope of the ground along x and y over a circle of each radius, and (N,) depth of
        the ground's deepest point on the circle below a plane of that slope through its centre.
    """
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    way = np.column_stack((np.cos(angles), np.sin(angles)))
    around = xy[:, None] + radius_m[:, None, None] * way
    centre_m = ground.height_at(xy)
    rise_m = ground.height_at(around.reshape(-1, 2)).reshape(len(xy), -1) - centre_m[:, None]
    rise_m = np.nan_to_num(rise_m)
    # Least squares over evenly spaced directions reduces to means, as in a Fourier series.
    slope = 2 * (rise_m @ way) / (len(way) * radius_m[:, None])
    hollow_m = -(rise_m - (slope @ way.T) * radius_m[:, None]).min(axis=1)
    return slope, np.maximum(hollow_m, 0)


def leaning(slope: FloatArray, share: float = 1.0) -> Rotation:
    """Return (N,) rotations that tilt the z axis by a share of the angle to the ground's normal.

    Args:
        slope: (N, 2) slopes of the ground along x and y.
        share: With 1 the z axis becomes the normal, by the shortest rotation.
    """
    from scipy.spatial.transform import Rotation

    steepness = np.linalg.norm(slope, axis=1)
    axis = np.column_stack((slope[:, 1], -slope[:, 0], np.zeros(len(slope))))
    angle_rad = share * np.arctan(steepness)
    return Rotation.from_rotvec(axis * (angle_rad / np.maximum(steepness, 1e-12))[:, None])
