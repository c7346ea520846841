"""Stones on a tile: convex, faceted and overlapping, each resting on what is below it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.types import FloatArray

SIDES, TOPS = 8, 3
"""Number of facets around a stone and on top of it."""

CHUNK_PX = 400_000
"""Pixels computed at once; stones of one chunk do not rest on each other."""


class StoneSpec(NamedTuple):
    """The parameters of a set of stones.

    Attributes:
        number: Number of stones on the tile.
        radius: (smallest, largest) radius as a share of the tile's edge.
        exponent: Exponent of the power law: the number above radius R goes as R**-exponent.
        flatness: Height of a stone relative to its radius.
        edge: Softness of the edges, 0.02 for broken and 0.15 for worn stones.
        buried: Share of the height below the ground.
    """

    number: int
    radius: tuple[float, float]
    exponent: float = 2.0
    flatness: float = 0.8
    edge: float = 0.05
    buried: float = 0.3


class StoneBed:
    """The surface of a tile to which stones are added.

    Attributes:
        height: (N, N) float32 in tile edges.
        ids: (N, N) int64 index of the stone on top, -1 on bare ground.
        above: (N, N) float32 height above the stone's foot relative to its top; 0 on bare ground.
        count: Number of stones so far.
    """

    def __init__(self, height: Field) -> None:
        self.height = np.ascontiguousarray(height)
        self.ids = np.full(height.shape, -1, np.int64)
        self.above = np.zeros(height.shape, np.float32)
        self.count = 0

    def add_stones(
        self, spec: StoneSpec, rng: np.random.Generator, density: Field | None = None
    ) -> None:
        """Add stones, small ones first.

        Args:
            spec: The stones to add.
            rng: Draws their positions and shapes.
            density: (N, N) probability, 0 to 1, that a stone is kept; None keeps all.
        """
        size_px = len(self.height)
        centre = rng.uniform(0, size_px, (spec.number, 2))
        stays = rng.uniform(size=spec.number)
        if density is not None:
            row, column = centre.astype(np.intp).T
            centre = centre[stays < density[row, column]]
        radius_px = np.sort(_power_law(len(centre), spec, rng)) * size_px
        facets = _facets(len(centre), rng)
        first = 0
        while first < len(centre):
            half = int(np.ceil(1.25 * radius_px[first] + 1))
            # A window fits the stones up to a fifth larger than the first.
            half = int(np.ceil(1.2 * half))
            room = max(1, CHUNK_PX // (2 * half + 1) ** 2)
            fits = int(np.searchsorted(radius_px, (half - 1) / 1.25, side="right"))
            last = max(first + 1, min(first + room, fits))
            part = slice(first, last)
            self._lay(centre[part], radius_px[part], facets[part], half, spec)
            first = last

    def _lay(
        self,
        centre: FloatArray,
        radius_px: FloatArray,
        facets: NDArray[np.float32],
        half: int,
        spec: StoneSpec,
    ) -> None:
        size_px = len(self.height)
        corner = np.floor(centre).astype(np.int64)
        offset = np.arange(-half, half + 1)
        scale = radius_px[:, None]
        v = ((corner[:, :1] + offset + 0.5 - centre[:, :1]) / scale).astype(np.float32)
        u = ((corner[:, 1:] + offset + 0.5 - centre[:, 1:]) / scale).astype(np.float32)
        dome = _soft_hull(u, v, facets, np.float32(spec.edge))
        dome *= np.float32(spec.flatness)
        inside = dome > 0
        rows, columns = (
            (corner[:, :1] + offset) % size_px,
            (corner[:, 1:] + offset) % size_px,
        )
        flat = rows[:, :, None] * size_px + columns[:, None, :]
        ground = self.height.ravel()[flat]
        rest = (ground * inside).sum((1, 2)) / np.maximum(inside.sum((1, 2)), 1)
        top = dome.max((1, 2))
        rise = (radius_px / size_px).astype(np.float32)
        base = rest - np.float32(spec.buried) * top * rise
        z = base[:, None, None] + dome * rise[:, None, None]
        stone, y, x = np.nonzero(inside & (z > ground))
        # Write from low to high, so that the highest stone of the chunk remains.
        order = np.argsort(z[stone, y, x], kind="stable")
        stone, y, x = stone[order], y[order], x[order]
        target = flat[stone, y, x]
        self.height.ravel()[target] = z[stone, y, x]
        self.ids.ravel()[target] = self.count + stone
        self.above.ravel()[target] = dome[stone, y, x] / top[stone]
        self.count += len(centre)


def _power_law(count: int, spec: StoneSpec, rng: np.random.Generator) -> FloatArray:
    """Return (count,) radii from a truncated power law, by inverse transform."""
    low, high = spec.radius
    tail = 1 - (low / high) ** spec.exponent
    share = rng.uniform(size=count) * tail
    return np.asarray(low * (1 - share) ** (-1 / spec.exponent))


def _facets(count: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return (count, SIDES + TOPS, 3): height = a + b * u + c * v of each facet's plane."""
    shape = (count, SIDES)
    azimuth = (np.arange(SIDES) + rng.uniform(-0.45, 0.45, shape)) * (2 * np.pi / SIDES)
    azimuth = np.concatenate((azimuth, rng.uniform(0, 2 * np.pi, (count, TOPS))), axis=1)
    elevation = np.concatenate(
        (rng.uniform(0.15, 0.9, shape), rng.uniform(1.15, np.pi / 2, (count, TOPS))),
        axis=1,
    )
    distance = np.concatenate(
        (rng.uniform(0.62, 0.92, shape), rng.uniform(0.5, 0.85, (count, TOPS))), axis=1
    )
    # Stretch each stone in one direction by stretching its planes.
    turn, narrow = rng.uniform(0, np.pi, (count, 1)), rng.uniform(0.55, 1.0, (count, 1))
    along, across = np.cos(azimuth), np.sin(azimuth) / narrow
    tilt = 1 / np.tan(elevation)
    b = -tilt * (np.cos(turn) * along - np.sin(turn) * across)
    c = -tilt * (np.sin(turn) * along + np.cos(turn) * across)
    planes = np.stack((distance / np.sin(elevation), b, c), axis=-1)
    return np.asarray(planes, np.float32)


def _soft_hull(
    u: NDArray[np.float32],
    v: NDArray[np.float32],
    facets: NDArray[np.float32],
    edge: np.float32,
) -> NDArray[np.float32]:
    """Return (S, W, W) heights under all planes, their edges rounded by a soft minimum."""
    total = np.zeros((len(u), v.shape[1], u.shape[1]), np.float32)
    for k in range(facets.shape[1]):
        a, b, c = (facets[:, k, i, None, None] for i in range(3))
        plane = a + c * v[:, :, None]
        plane = plane + b * u[:, None, :]
        total += np.exp(np.minimum(-plane / edge, 60))
    return np.asarray(-edge * np.log(total), np.float32)
