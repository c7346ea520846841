"""Growth of stems: how a stem bends, and where and in which directions new ones leave it.

All stems of one order are computed together, as arrays. Lengths are relative to the plant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import ConfigDict

from oaisys_core.procedural.scatter.plants.organ_sizes import STRICT
from oaisys_core.types import FloatArray

UP = np.array((0.0, 0.0, 1.0))

GOLDEN_RAD = float(np.pi * (3 - 5**0.5))
"""Angle between successive leaves around a stem, by which they shade each other least."""


@dataclass(frozen=True)
class StemRule:
    """How stems of one order grow on stems of the order below.

    Attributes:
        count: Stems on each parent.
        span: Shares of the parent's length between which they start.
        length: Length as a share of the parent's.
        outline: Factors on the length at the lowest, at the middle and at the highest start.
        angle_deg: Angles from the parent's direction at the lowest and at the highest start.
        bend: By how much the stem turns up (negative: down) along its length.
        wander: By how much its direction changes at random.
        points: Number of points along it.
        thickness: Its radius at the foot as a share of the parent's there.
        taper: Radius at the tip as a share of that at the foot.
        jitter: Relative random variation of lengths, angles and places.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    count: int
    span: tuple[float, float] = (0.2, 0.95)
    length: float = 0.4
    outline: tuple[float, float, float] = (1.0, 1.0, 1.0)
    angle_deg: tuple[float, float] = (60.0, 35.0)
    bend: float = 0.0
    wander: float = 0.15
    points: int = 4
    thickness: float = 0.6
    taper: float = 0.3
    jitter: float = 0.15


@dataclass(frozen=True)
class Stems:
    """S stems of K points each.

    Attributes:
        points_m: (S, K, 3) points from foot to tip.
        radii_m: (S, K) radii.
    """

    points_m: FloatArray
    radii_m: FloatArray

    @property
    def lengths_m(self) -> FloatArray:
        """(S,) lengths."""
        steps = np.linalg.norm(np.diff(self.points_m, axis=1), axis=-1)
        return np.asarray(steps.sum(axis=1))

    def at(self, shares: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return points (S, N, 3), directions (S, N, 3) and radii (S, N) at (S, N) shares."""
        last = self.points_m.shape[1] - 1
        place = np.clip(shares, 0, 1) * last
        low = np.minimum(place.astype(np.intp), last - 1)
        t = (place - low)[..., None]
        rows = np.arange(len(self.points_m))[:, None]
        foot, head = self.points_m[rows, low], self.points_m[rows, low + 1]
        thin = self.radii_m[rows, low], self.radii_m[rows, low + 1]
        radii = thin[0] + (thin[1] - thin[0]) * t[..., 0]
        return foot + (head - foot) * t, unit(head - foot), radii


def stems(
    feet_m: FloatArray,
    directions: FloatArray,
    lengths_m: FloatArray,
    radii_m: FloatArray,
    rule: StemRule,
    rng: np.random.Generator,
) -> Stems:
    """Return S stems from feet in directions, (S, 3), with (S,) lengths and radii at the foot."""
    count, steps = len(feet_m), rule.points - 1
    points = [feet_m]
    ahead = unit(directions)
    for _ in range(steps):
        points.append(points[-1] + ahead * (lengths_m / steps)[:, None])
        turn = rule.bend / steps * UP + rule.wander / steps**0.5 * rng.normal(size=(count, 3))
        ahead = unit(ahead + turn)
    radii = radii_m[:, None] * np.linspace(1, rule.taper, rule.points)
    return Stems(np.stack(points, axis=1), radii)


def branches(parents: Stems, rule: StemRule, rng: np.random.Generator) -> Stems:
    """Return the stems that grow on parents by a rule."""
    shares = _shares(len(parents.points_m), rule.count, rule.span, rule.jitter, rng)
    feet, directions, radii = departures(parents, shares, rule.angle_deg, rule.jitter, rng)
    relative = (shares - rule.span[0]) / max(rule.span[1] - rule.span[0], 1e-6)
    outline = np.interp(relative, (0.0, 0.5, 1.0), rule.outline)
    lengths = rule.length * parents.lengths_m[:, None] * outline
    lengths = lengths * np.clip(1 + rule.jitter * rng.normal(size=lengths.shape), 0.4, 1.8)
    return stems(
        feet.reshape(-1, 3),
        directions.reshape(-1, 3),
        lengths.ravel(),
        (rule.thickness * radii).ravel(),
        rule,
        rng,
    )


def departures(
    parents: Stems,
    shares: FloatArray,
    angle_deg: tuple[float, float],
    jitter: float,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return feet, directions (S, N, 3) and parents' radii (S, N) of what leaves at (S, N) shares.

    Args:
        parents: The stems.
        shares: Shares of their lengths, ascending.
        angle_deg: Angle from the parent's direction at share 0 and at share 1.
        jitter: Relative random variation of the angles.
        rng: Draws it.
    """
    feet, along, radii = parents.at(shares)
    count, number = shares.shape
    around = GOLDEN_RAD * np.arange(number) + rng.uniform(0, 2 * np.pi, (count, 1))
    around = around + jitter * rng.normal(size=shares.shape)
    angle = np.radians(angle_deg[0] + (angle_deg[1] - angle_deg[0]) * shares)
    angle = angle * (1 + jitter * rng.normal(size=shares.shape))
    side = across(along)
    other = np.cross(along, side)
    out = np.cos(around)[..., None] * side + np.sin(around)[..., None] * other
    directions = np.cos(angle)[..., None] * along + np.sin(angle)[..., None] * out
    return feet, directions, radii


def spread_shares(
    stem_count: int, number: int, span: tuple[float, float], rng: np.random.Generator
) -> FloatArray:
    """Return (S, N) ascending shares within a span, one at random in each of N equal parts."""
    return _shares(stem_count, number, span, 1.0, rng)


def _shares(
    stem_count: int,
    number: int,
    span: tuple[float, float],
    jitter: float,
    rng: np.random.Generator,
) -> FloatArray:
    part = np.arange(number) + 0.5 + jitter * rng.uniform(-0.5, 0.5, (stem_count, number))
    return np.asarray(span[0] + (span[1] - span[0]) * part / number)


def unit(vectors: FloatArray) -> FloatArray:
    """Return (..., 3) vectors with length 1."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


def across(along: FloatArray) -> FloatArray:
    """Return (..., 3) unit vectors perpendicular to (..., 3) unit vectors, level if possible."""
    steep = np.abs(along[..., 2:]) > 0.95
    return unit(np.cross(np.where(steep, (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), along))


def level_vectors(rng: np.random.Generator, count: int) -> FloatArray:
    """Return (count, 3) random horizontal vectors, whose x and y are normally distributed."""
    vectors = rng.normal(size=(count, 3))
    vectors[:, 2] = 0.0
    return vectors
