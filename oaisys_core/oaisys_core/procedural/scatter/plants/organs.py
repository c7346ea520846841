"""Geometry of stems, leaves and needles, many at a time, with few triangles each.

Colours are sRGB-encoded, 0 to 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.procedural.scatter.mesh_builder import MeshBuilder
from oaisys_core.procedural.scatter.plants.growth import UP, Stems, across, unit
from oaisys_core.scene.objects import MOST_NEEDLES
from oaisys_core.types import FloatArray

LEAF_TRANSLUCENCY = 0.45
"""Share of the scattered light that leaves a leaf on the other side."""

NEEDLE_TRANSLUCENCY = 0.2

WIDEST, SIMPLE_FOLD = 0.4, 0.3
"""Of leaves of two triangles: where they are widest, as a share of the length, and the height of
their sides above the midrib, as a share of half the width."""


class Organs(NamedTuple):
    """N leaves, needles or shoots.

    Attributes:
        feet_m, directions: (N, 3) places and directions.
        lengths_m, widths_m: (N,) sizes.
        colors: (N, 3) colours.
    """

    feet_m: FloatArray
    directions: FloatArray
    lengths_m: FloatArray
    widths_m: FloatArray
    colors: FloatArray


def add_stems(parts: MeshBuilder, stems: Stems, colors: ArrayLike, sides: int = 3) -> None:
    """Add tubes along stems, with a (3,) colour, (S, 3) colours or (S, K, 3) colours."""
    points, radii = stems.points_m, stems.radii_m
    count, along_count = radii.shape
    along = unit(np.gradient(points, axis=1))
    side = across(along)
    other = np.cross(along, side)
    angle = np.arange(sides) * (2 * np.pi / sides)
    ring = np.cos(angle)[:, None] * side[:, :, None] + np.sin(angle)[:, None] * other[:, :, None]
    vertices = points[:, :, None] + radii[:, :, None, None] * ring
    stem, row, corner = np.meshgrid(
        np.arange(count), np.arange(along_count - 1), np.arange(sides), indexing="ij"
    )
    first = (stem * along_count + row) * sides
    a, b = (first + corner).ravel(), (first + (corner + 1) % sides).ravel()
    triangles = np.vstack(
        (np.column_stack((a, b, b + sides)), np.column_stack((a, b + sides, a + sides)))
    )
    of_points = _colors(colors, count, along_count)
    parts.add(vertices.reshape(-1, 3), triangles, np.repeat(of_points, sides, axis=0))


def add_leaves(
    parts: MeshBuilder,
    organs: Organs,
    rng: np.random.Generator,
    *,
    fold: float = 0.25,
    droop: float = 0.25,
    face_up: float = 1.0,
    translucency: float = LEAF_TRANSLUCENCY,
) -> None:
    """Add leaves of four triangles, folded along the midrib, with their tips bent down.

    Args:
        parts: Where they are added.
        organs: The leaves.
        rng: Turns them.
        fold: Height of the sides above the midrib, as a share of half the width.
        droop: How much the tip hangs down: the length, times this, is added downwards before the
            leaf gets its length.
        face_up: How much they turn their upper sides towards the sky; 0 for any direction.
        translucency: Share of light that goes through.
    """
    feet_m, directions, lengths_m, widths_m, colors = organs
    ahead = unit(directions)
    side = unit(np.cross(ahead, face_up * UP + 0.6 * rng.normal(size=ahead.shape)))
    normal = np.cross(side, ahead)
    long = lengths_m[:, None]
    middle = feet_m + 0.5 * long * ahead
    half = 0.5 * widths_m[:, None]
    left = feet_m + 0.42 * long * ahead - half * side + fold * half * normal
    right = feet_m + 0.42 * long * ahead + half * side + fold * half * normal
    tip = feet_m + long * unit(ahead - droop * UP)
    corners = np.stack((feet_m, left, middle, right, tip), axis=1)
    faces = np.array(((0, 3, 2), (0, 2, 1), (3, 4, 2), (2, 4, 1)))
    shade = np.array((0.85, 1.0, 0.92, 1.0, 1.08))
    _add(parts, corners, faces, colors[:, None] * shade[:, None], translucency)


def add_simple_leaves(
    parts: MeshBuilder,
    organs: Organs,
    rng: np.random.Generator,
    *,
    droop: float = 0.25,
) -> None:
    """Add leaves of two triangles each, folded along the midrib, widest below their middle."""
    feet_m, directions, lengths_m, widths_m, colors = organs
    ahead = unit(unit(directions) - 0.5 * droop * UP)
    side = unit(np.cross(ahead, UP + 0.6 * rng.normal(size=ahead.shape)))
    normal = np.cross(side, ahead)
    long, half = lengths_m[:, None], 0.5 * widths_m[:, None]
    near = feet_m + WIDEST * long * ahead + SIMPLE_FOLD * half * normal
    tip = feet_m + long * ahead
    corners = np.stack((feet_m, near + half * side, tip, near - half * side), axis=1)
    shade = np.array((0.85, 1.0, 1.08, 1.0))
    _add(parts, corners, np.array(((0, 1, 2), (0, 2, 3))), colors[:, None] * shade[:, None],
         LEAF_TRANSLUCENCY)  # fmt: skip


def add_kites(
    parts: MeshBuilder,
    organs: Organs,
    rng: np.random.Generator,
) -> None:
    """Add flat leaves of two triangles that face any direction."""
    feet_m, directions, lengths_m, widths_m, colors = organs
    ahead = unit(directions)
    side = unit(np.cross(ahead, rng.normal(size=ahead.shape)))
    long, half = lengths_m[:, None], 0.5 * widths_m[:, None]
    middle = feet_m + 0.5 * long * ahead
    corners = np.stack(
        (feet_m, middle - half * side, feet_m + long * ahead, middle + half * side), axis=1
    )
    _add(parts, corners, np.array(((0, 1, 2), (0, 2, 3))), colors[:, None], LEAF_TRANSLUCENCY)


SHOOT_TRIANGLES, FORK_TRIANGLES = 4, 2

FORK_ROOT = 0.25
"""Share of a fork's shoot at which the needle begins that ends in the corner at its side."""

SPREAD = 0.82
"""Share of a needle's length by which it stands off its twig."""


def add_shoots(
    parts: MeshBuilder,
    organs: Organs,
    rng: np.random.Generator,
    needle_m: float,
    *,
    slim: bool = False,
) -> None:
    """Add shoots full of needles: four teeth around a spine, each as long as the shoot is wide.

    Args:
        parts: Where they are added.
        organs: The shoots.
        rng: Turns them.
        needle_m: Distance of the needles that a tooth stands for, see `_numbers`.
        slim: Whether teeth take a third of the spine; others take half.
    """
    feet_m, directions, lengths_m, teeth_m, colors = organs
    ahead = unit(directions)
    first = unit(np.cross(ahead, UP + 0.5 * rng.normal(size=ahead.shape)))
    second = np.cross(ahead, first)
    along = lengths_m[:, None] * ahead
    spine = np.linspace(0, 1, 4 if slim else 3)
    apexes = (0.25, 0.45, 0.6, 0.9) if slim else (0.32, 0.2, 0.7, 0.6)
    corners = [feet_m + share * along for share in spine]
    for share, turn_deg in zip(apexes, (5.0, 165.0, -40.0, 205.0), strict=True):
        turn = np.radians(turn_deg)
        side = np.cos(turn) * first + np.sin(turn) * second
        tooth = teeth_m[:, None] * unit(SPREAD * side + 0.57 * ahead)
        corners.append(feet_m + share * along + tooth)
    if slim:
        faces = np.array(((0, 1, 4), (1, 2, 5), (1, 2, 6), (2, 3, 7)))
    else:
        faces = np.array(((0, 1, 3), (0, 1, 4), (1, 2, 5), (1, 2, 6)))
    shade = np.concatenate((np.linspace(0.72, 1.05, len(spine)), (1.1, 1.1, 1.15, 1.15)))
    _add(parts, np.stack(corners, axis=1), faces, colors[:, None] * shade[:, None],
         needles=_numbers(lengths_m, needle_m, (*spine, *apexes)))  # fmt: skip


def _numbers(lengths_m: FloatArray, needle_m: float, shares: Sequence[float]) -> FloatArray:
    """Return (N, C) numbers of needles before shares of shoots of (N,) lengths.

    Needles are ``needle_m`` apart along a shoot, or farther where they would be more than a row may
    have.
    """
    count = np.minimum(lengths_m / needle_m, MOST_NEEDLES)
    return np.asarray(count[:, None] * np.asarray(shares, np.float64))


def add_forks(
    parts: MeshBuilder,
    organs: Organs,
    rng: np.random.Generator,
    needle_m: float,
) -> None:
    """Add pairs of shoots as they look from afar: two triangles that begin at one point.

    ``needle_m`` is as in `add_shoots`.
    """
    feet_m, directions, lengths_m, widths_m, colors = organs
    ahead = unit(directions)
    level = unit(np.cross(ahead, UP + 0.5 * rng.normal(size=ahead.shape)))
    corners = [feet_m]
    for sign in (-1.0, 1.0):
        way = unit(ahead + sign * 0.45 * level)
        side = unit(np.cross(way, rng.normal(size=way.shape)))
        tip = feet_m + lengths_m[:, None] * way
        corners += [tip, feet_m + 0.4 * lengths_m[:, None] * way + widths_m[:, None] * side]
    shade = np.array((0.72, 1.12, 0.95, 1.12, 0.95))
    faces = np.array(((0, 1, 2), (0, 3, 4)))
    roots = (0.0, 1.0, FORK_ROOT, 1.0, FORK_ROOT)
    _add(parts, np.stack(corners, axis=1), faces, colors[:, None] * shade[:, None],
         needles=_numbers(lengths_m, needle_m, roots))  # fmt: skip


def add_needles(
    parts: MeshBuilder,
    organs: Organs,
    rng: np.random.Generator,
    translucency: float = NEEDLE_TRANSLUCENCY,
) -> None:
    """Add needles of one triangle each."""
    feet_m, directions, lengths_m, widths_m, colors = organs
    ahead = unit(directions)
    side = unit(np.cross(ahead, rng.normal(size=ahead.shape)))
    half = 0.5 * widths_m[:, None] * side
    corners = np.stack((feet_m - half, feet_m + half, feet_m + lengths_m[:, None] * ahead), axis=1)
    shade = np.array((0.8, 0.8, 1.12))
    _add(parts, corners, np.array(((0, 1, 2),)), colors[:, None] * shade[:, None], translucency)


def add_blades(
    parts: MeshBuilder,
    stems: Stems,
    widths_m: FloatArray,
    feet_srgb: FloatArray,
    tips_srgb: FloatArray,
    rng: np.random.Generator,
    translucency: float = NEEDLE_TRANSLUCENCY,
) -> None:
    """Add blades of grass along stems: strips of (S,) widths that end in points.

    ``feet_srgb`` and ``tips_srgb`` are (S, 3) colours, mixed along the blades.
    """
    points = stems.points_m
    count, along_count = points.shape[:2]
    chord = unit(points[:, -1] - points[:, 0])
    level = across(chord)
    twist = rng.normal(0, 0.5, (count, 1))
    side = np.cos(twist) * level + np.sin(twist) * np.cross(chord, level)
    share = np.linspace(0, 1, along_count)
    half = 0.5 * widths_m[:, None] * np.sqrt(1 - share**2) * (0.7 + 0.6 * np.sqrt(share))
    offset = half[:, :-1, None] * side[:, None]
    body = points[:, :-1]
    corners = np.concatenate((body - offset, body + offset, points[:, -1:]), axis=1)
    low = np.arange(along_count - 2)
    right = low + along_count - 1
    last = 2 * along_count - 2
    faces = np.vstack(
        (
            np.column_stack((low, right, right + 1)),
            np.column_stack((low, right + 1, low + 1)),
            [[along_count - 2, last - 1, last]],
        )
    )
    mix = np.concatenate((share[:-1], share[:-1], share[-1:]))[:, None]
    colors = feet_srgb[:, None] * (1 - mix) + tips_srgb[:, None] * mix
    _add(parts, corners, faces, colors, translucency)


def shades(
    rng: np.random.Generator, color: ArrayLike, other: ArrayLike, count: int, spread: float = 0.12
) -> FloatArray:
    """Return (count, 3) colours between two, with random brightness."""
    share = rng.uniform(size=(count, 1)) ** 1.5
    first, second = np.asarray(color, np.float64), np.asarray(other, np.float64)
    bright = np.clip(1 + spread * rng.normal(size=(count, 1)), 0.6, 1.5)
    return np.asarray(np.clip((first + (second - first) * share) * bright, 0.01, 1))


def mix_colors(first: ArrayLike, second: ArrayLike, share: ArrayLike) -> FloatArray:
    """Return colours between two; a share of 1 is the second."""
    first, second = np.asarray(first, np.float64), np.asarray(second, np.float64)
    return np.asarray(first + (second - first) * np.asarray(share))


def _add(
    parts: MeshBuilder,
    corners: FloatArray,
    faces: NDArray[np.int64],
    colors: FloatArray,
    translucency: float = NEEDLE_TRANSLUCENCY,
    needles: FloatArray | None = None,
) -> None:
    """Add N copies of a pattern: (N, C, 3) corners, (F, 3) faces of each, colours as corners.

    ``needles`` are (N, C) numbers, see `MeshBuilder.add`.
    """
    count, number = corners.shape[:2]
    triangles = (faces[None] + number * np.arange(count)[:, None, None]).reshape(-1, 3)
    of_corners = np.broadcast_to(colors, corners.shape).reshape(-1, 3)
    parts.add(
        corners.reshape(-1, 3),
        triangles,
        of_corners,
        translucency=translucency,
        needles=0.0 if needles is None else needles.ravel(),
    )


def _colors(colors: ArrayLike, count: int, along_count: int) -> FloatArray:
    given = np.asarray(colors, np.float64)
    if given.ndim == 2:
        given = given[:, None]
    return np.broadcast_to(given, (count, along_count, 3)).reshape(-1, 3)
