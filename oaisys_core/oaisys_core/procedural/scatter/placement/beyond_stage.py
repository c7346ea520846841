"""Plants and rocks on the land around a stage, so that they do not end where the stage does."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config.sections.density import LayerDensity, SlopeDensity
from oaisys_core.config.sections.groups import GroupConfig
from oaisys_core.procedural.scatter.ids import ON_LAND
from oaisys_core.procedural.scatter.placement.density import make_density
from oaisys_core.procedural.scatter.placement.random_poses import slope_deg
from oaisys_core.procedural.scatter.rocks import ROCK_KINDS
from oaisys_core.procedural.scatter.shapes import PLANTS
from oaisys_core.procedural.terrain.surroundings.far_ground import GroundAround
from oaisys_core.scene.terrain_material import TerrainMaterial
from oaisys_core.types import FloatArray

LEAST_M = 1.0
"""Plants of groups with sizes from here on go on beyond the stage, unless their group says no."""

REACH = 30.0
"""Distance from the stage, in units of a thing's size, at which the last one of its size stands:
there it is 18 pixels high in a picture of 640 pixels and 60 degrees."""

MAX_TILES = 8
"""Stages beside the stage, along each axis, into which its things are mirrored."""

JITTER = 0.25
"""Standard deviation of the shift of a mirrored thing, in mean distances between the things."""

LEAST_DENSITY = 0.05
"""Density on the stage below which a mirrored plant does not become likelier than its image."""


class PlacesBeyond(NamedTuple):
    """Where N plants or rocks stand on the land around a stage.

    Attributes:
        xy_m: (N, 2) positions in ``map``.
        like: (N,) index of the one on the stage that each of them is like.
        distance: (N,) distance from the stage's edge, in units of its size.
    """

    xy_m: FloatArray
    like: NDArray[np.intp]
    distance: FloatArray


def goes_beyond(group: GroupConfig) -> bool:
    """Return whether a group's plants or rocks also stand on the land around the stage."""
    if group.beyond_stage is None:
        is_large_plant = group.shape in PLANTS and group.size_m[1] >= LEAST_M
        return is_large_plant or group.shape in ROCK_KINDS
    return group.beyond_stage


def plant_places_beyond(
    group: GroupConfig,
    xy_m: FloatArray,
    sizes_m: FloatArray,
    ground: GroundAround,
    material: TerrainMaterial | None,
    rng: np.random.Generator,
    is_under: Callable[[FloatArray], NDArray[np.bool_]] | None = None,
    most: int = ON_LAND,
) -> PlacesBeyond:
    """Return where plants stand beyond a stage, given the (N, 2) places and (N,) sizes on it.

    Layers and slopes of the land count as those of the stage do; see `places_beyond`. ``is_under``
    says at which (N, 2) points the water on the land is too deep for them; None: there is none.
    ``most`` is the largest number.
    """

    def suits(found: PlacesBeyond) -> NDArray[np.bool_]:
        suited = _suits(group, xy_m, found, ground, material, rng)
        return suited if is_under is None else suited & ~is_under(found.xy_m)

    return places_beyond(xy_m, sizes_m, ground, rng, suits, most=most)


def places_beyond(
    xy_m: FloatArray,
    sizes_m: FloatArray,
    ground: GroundAround,
    rng: np.random.Generator,
    suits: Callable[[PlacesBeyond], NDArray[np.bool_]],
    margin_m: float = 0.0,
    most: int = ON_LAND,
) -> PlacesBeyond:
    """Return where things stand beyond a stage, given the (N, 2) places and (N,) sizes on it.

    The things of the stage are mirrored at its edges and shifted a little, so that their number is
    the same on both sides of an edge. They get fewer with the distance in units of their sizes, up
    to `REACH`, or nearer if they would be more than ``most``. ``suits`` says where they may.
    Those of the stage keep ``margin_m`` from its edge, and are mirrored at that distance from it.
    """
    x0, y0, x1, y1 = ground.extent_m
    edge_m = np.array(((x0, y0), (x1, y1)))
    low_m = edge_m[0] + margin_m
    span_m = edge_m[1] - margin_m - low_m
    shift_m = JITTER * float(np.sqrt(span_m.prod() / max(len(xy_m), 1)))
    places, likes, distances, turns = [], [], [], []
    share = (xy_m - low_m) / span_m
    for tile in _tiles(span_m, xy_m, sizes_m):
        mirrored_m = low_m + (tile + np.where(tile % 2, 1 - share, share)) * span_m
        mirrored_m = mirrored_m + rng.normal(scale=shift_m, size=xy_m.shape)
        beyond_m = np.maximum(np.maximum(edge_m[0] - mirrored_m, mirrored_m - edge_m[1]), 0)
        distance = np.hypot(*beyond_m.T) / sizes_m
        # Those below any number are spread as if that number were the reach.
        turn = distance / np.maximum(1 - rng.uniform(size=len(distance)), 1e-9)
        stands = (beyond_m.max(axis=1) > sizes_m / 2) & (turn < REACH)
        places.append(mirrored_m[stands])
        likes.append(np.flatnonzero(stands))
        distances.append(distance[stands])
        turns.append(turn[stands])
    found = PlacesBeyond(np.concatenate(places), np.concatenate(likes), np.concatenate(distances))
    may = suits(found)
    first = np.argsort(np.where(may, np.concatenate(turns), np.inf), kind="stable")
    chosen = np.sort(first[: min(most, int(may.sum()))])
    return PlacesBeyond(found.xy_m[chosen], found.like[chosen], found.distance[chosen])


def _tiles(span_m: FloatArray, xy_m: FloatArray, sizes_m: FloatArray) -> NDArray[np.int64]:
    """Return (T, 2) columns and rows of the stages beside the stage that may have plants."""
    reach = int(np.clip(np.ceil(REACH * sizes_m.max(initial=0.0) / span_m.min()), 1, MAX_TILES))
    index = np.arange(-reach, reach + 1) if len(xy_m) <= ON_LAND else np.arange(-1, 2)
    tiles = np.stack(np.meshgrid(index, index), axis=-1).reshape(-1, 2)
    return np.asarray(tiles[tiles.any(axis=1)])


def _suits(
    group: GroupConfig,
    xy_m: FloatArray,
    found: PlacesBeyond,
    ground: GroundAround,
    material: TerrainMaterial | None,
    rng: np.random.Generator,
) -> NDArray[np.bool_]:
    """Return (M,) whether the land suits plants as the stage suits those that they are like."""
    local = [each for each in group.density if isinstance(each, LayerDensity | SlopeDensity)]
    density = make_density(local, ground, rng, material)
    on_stage = np.maximum(density(xy_m), LEAST_DENSITY)
    likely = density(found.xy_m) / on_stage[found.like]
    gentle = slope_deg(ground, found.xy_m) <= group.max_slope_deg
    return np.asarray(gentle & (rng.uniform(size=len(likely)) < likely))
