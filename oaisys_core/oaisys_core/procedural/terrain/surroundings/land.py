"""Land: relief as on the stage, with larger and larger forms, on the curved surface of a body.

At its edge, the stage's heights and slopes go on. Further away, each octave of the relief sets in
within half its wavelength, as strong as on the stage; octaves that are longer than the stage are
extrapolated. The body's curvature lowers it with the square of the distance from the edge.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.procedural.terrain.surroundings.border import Border, BorderContinuation, border_of
from oaisys_core.procedural.terrain.surroundings.far_ground import FarGroundMesh
from oaisys_core.procedural.terrain.surroundings.horizon import HorizonView
from oaisys_core.procedural.terrain.surroundings.land_detail import LandReliefPattern
from oaisys_core.procedural.terrain.surroundings.octaves import (
    OctaveHeights,
    Shaper,
    octave_heights,
)
from oaisys_core.procedural.terrain.surroundings.rings import Ring, rings_around, triangles_between
from oaisys_core.procedural.terrain.surroundings.spectrum import longer_octaves, own_octaves
from oaisys_core.scene import Ground
from oaisys_core.types import FloatArray

HIGHEST_VIEW_M = 20_000.0
"""Height above the stage from which the land still reaches to the horizon."""

LONGEST_WAVE_M = 40_000.0
"""Longest wavelength of relief that the stage itself does not have."""

ONSET = 0.5
"""Distance from the stage's edge within which an octave sets in, in wavelengths."""

STEPS = 500
"""Steps of the border's heights in which its highest and its lowest point are looked for."""

SHARE_STEPS = 7
"""Number of halvings by which the height of long forms is found that lets a low sun in."""

SKIRT_M = 1.0
"""Height of a wall below the stage's edge, so that no ray passes between stage and land, where the
stage has finer detail or is a mesh with another outline."""


def land_around(
    stage: Ground,
    seed: int,
    body_radius_m: float,
    highest_rad: float | None = None,
    shaped_by: Shaper = "water",
) -> FarGroundMesh:
    """Return the land around a stage.

    Args:
        stage: The stage; the land depends on all of its heights.
        seed: Seed of the relief; with one seed, other stages have other land.
        body_radius_m: Radius of the body whose surface it is.
        highest_rad: Elevation above which no hill may rise, as seen from the stage: forms that are
            longer than the stage become lower. None: they are as high as they are.
        shaped_by: What made its forms.
    """
    border = border_of(stage)
    rings = rings_around(border, sqrt(2 * body_radius_m * HIGHEST_VIEW_M))
    xy_m = np.concatenate([ring.xy_m(border) for ring in rings])
    height_m = _continue(border, rings)
    distance_m = border.distance_m(xy_m)
    spacing_m = np.repeat([ring.spacing_m for ring in rings], [len(r.along) for r in rings])
    own = own_octaves(stage)
    octaves = [*own, *longer_octaves(own, LONGEST_WAVE_M)]

    rngs = _streams(border, seed, len(octaves))
    formed = octave_heights(xy_m, spacing_m, octaves, rngs, shaped_by)
    own_m, longer_m = _relief(distance_m, formed, own[-1].wavelength_m)
    own_m += height_m - curvature_drop_m(distance_m, body_radius_m)
    if highest_rad is not None:
        share = _share_below(highest_rad, HorizonView(stage, xy_m), own_m, own_m + longer_m)
        longer_m *= share
        octaves = [*own, *(each._replace(share=share) for each in octaves[len(own) :])]
    height_m = own_m + longer_m
    vertices_m = np.column_stack((xy_m, height_m)).astype(np.float32)
    triangles = triangles_between(rings)
    wall_m, wall_triangles = _skirt(vertices_m[: len(rings[0].along)], len(vertices_m))
    return FarGroundMesh(
        stage=stage,
        vertices_m=np.concatenate((vertices_m, wall_m)),
        triangles=np.concatenate((triangles, wall_triangles)),
        inner_share=1.0 - 1e-6,
        level_m=None,
        cast_triangles=len(triangles) + len(wall_triangles),
        detail=LandReliefPattern(tuple(octaves), seed, shaped_by),
    )


def _share_below(
    highest_rad: float, view: HorizonView, least_m: FloatArray, most_m: FloatArray
) -> float:
    """Return the largest share, from 0 to 1, at which the horizon is not above an elevation.

    Args:
        highest_rad: The elevation.
        view: Finds the horizon.
        least_m, most_m: (N,) heights at a share of 0 and of 1.
    """
    if view.elevations_rad(most_m).max() <= highest_rad:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(SHARE_STEPS):
        share = (low + high) / 2
        is_below = view.elevations_rad(least_m + share * (most_m - least_m)).max() <= highest_rad
        low, high = (share, high) if is_below else (low, share)
    return low


def curvature_drop_m(distance_m: FloatArray, body_radius_m: float) -> FloatArray:
    """Return by how much a body's surface lies below its tangential plane at (N,) distances."""
    return np.asarray(distance_m**2 / (2 * body_radius_m))


def _relief(
    distance_m: FloatArray, formed: Iterable[OctaveHeights], longest_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return (N,) sums of the octaves up to a wavelength, and of the longer ones.

    Args:
        distance_m: (N,) distances from the stage, by which the octaves set in.
        formed: The octaves.
        longest_m: The wavelength.
    """
    own_m, longer_m = np.zeros((2, len(distance_m)))
    for octave, here, height_m in formed:
        total_m = own_m if octave.wavelength_m <= longest_m else longer_m
        total_m[here] += _step(distance_m[here] / (ONSET * octave.wavelength_m)) * height_m
    return own_m, longer_m


def endless_relief(
    land: FarGroundMesh, xy_m: FloatArray, spacing_m: FloatArray
) -> Iterator[tuple[float, FloatArray]]:
    """Yield the wavelength of each octave of a land's relief, and its (R, C) heights.

    It is the relief as if there were no stage: the octaves do not set in by distance.

    Args:
        land: Land from `land_around`.
        xy_m: (R, C, 2) points.
        spacing_m: (R,) distances between points in each row, by which short octaves are left out,
            whatever the size of the land's triangles.
    """
    if land.detail is None:
        return
    octaves = list(land.detail.octaves)
    rngs = _streams(border_of(land.stage), land.detail.seed, len(octaves))
    points_m, shape = xy_m.reshape(-1, 2), xy_m.shape[:2]
    apart_m = np.repeat(spacing_m, shape[1])
    shaped_by = land.detail.shaped_by
    for octave, here, height_m in octave_heights(points_m, apart_m, octaves, rngs, shaped_by):
        whole_m = np.zeros(len(points_m))
        whole_m[here] = octave.share * height_m
        yield octave.wavelength_m, whole_m.reshape(shape)


def _continue(border: Border, rings: list[Ring]) -> FloatArray:
    """Return the heights of the border, continued to all points of the rings."""
    continuation = BorderContinuation(border)
    heights = [border.height_m]
    heights += [continuation.at(ring.offset_m, ring.border_places(border)) for ring in rings[1:]]
    return np.concatenate(heights)


def _streams(border: Border, seed: int, count: int) -> list[np.random.Generator]:
    """Return the generators of some octaves, which rounding errors of heights do not change."""
    steps = np.round((border.height_m - border.level_m) / (np.ptp(border.height_m) + 1e-9) * STEPS)
    name = f"surroundings/{len(steps)}/{steps.argmax()}/{steps.argmin()}"
    return [randomness.stream(seed, name, index) for index in range(count)]


def _skirt(
    edge_m: NDArray[np.float32], first: int
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return vertices, counted from ``first``, and triangles of a wall below (P, 3) edge points."""
    count = len(edge_m)
    top = first + np.arange(count, dtype=np.int32)
    top_next = np.roll(top, -1)
    corners = ((top, top + count, top_next + count), (top, top_next + count, top_next))
    triangles = np.concatenate([np.column_stack(each) for each in corners])
    lowered_m = edge_m - np.array((0.0, 0.0, SKIRT_M), np.float32)
    return np.concatenate((edge_m, lowered_m)), triangles


def _step(share: FloatArray) -> FloatArray:
    """Return a smooth step from 0 to 1 over shares from 0 to 1."""
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))
