"""A river that wanders: bends grow outwards, cut banks, and leave bars and terraces behind.

Bends move by the curvature upstream of them (Howard and Knutson, "Sufficient conditions for river
meandering: a simulation approach", WRR 20(11), 1984), and are cut off where their necks meet.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

HERE, UPSTREAM = -1.0, 2.5
"""Weights of the curvature at a point and of that upstream, by Howard and Knutson."""

MEMORY = 1.2
"""Distance, in widths, over which the curvature upstream counts less by 1/e."""

POINTS = 0.35
"""Distance between points of the middle line, in widths."""

FINE = 0.08
"""The same of the line by which places beside the river are found."""

BLOCK_CELLS = 8
"""Edge, in cells, of the blocks whose distance from a line is found at once."""

FIXED = 8
"""Points at both ends that stay, so that the river enters and leaves in its own direction."""


class RiverBed(NamedTuple):
    """Where the points of a ground lie beside a river.

    Attributes:
        across: Distance to the middle line in half widths, positive on the left side.
        along: Place along the middle line in widths.
        bend: Curvature of the middle line times its width, positive to the left.
    """

    across: FloatArray
    along: FloatArray
    bend: FloatArray


def wander(line: FloatArray, width: float, rate: float) -> FloatArray:
    """Return (M, 2) points of a middle line after its bends have grown for one step.

    Args:
        line: (N, 2) points, downstream.
        width: Width of the channel.
        rate: By how much a bend with a radius of a width moves, in widths.
    """
    bend = curvature(line) * width
    memory = np.cumprod(np.full(int(6 * MEMORY / POINTS), 1.0 / (1.0 + POINTS / MEMORY)))
    memory = memory / memory.sum()
    upstream = np.convolve(np.concatenate((np.zeros(len(memory) - 1), bend)), memory, "valid")
    moved = rate * width * (HERE * bend + UPSTREAM * upstream)
    moved *= np.minimum(np.minimum(np.arange(len(line)), np.arange(len(line))[::-1]) / FIXED, 1.0)
    ahead = np.gradient(line, axis=0)
    ahead /= np.maximum(np.sqrt((ahead**2).sum(axis=1)), 1e-12)[:, None]
    # To the outside: against the side that the river turns to.
    outside = np.stack((ahead[:, 1], -ahead[:, 0]), axis=1)
    return even(cut_off(line + moved[:, None] * outside, width), POINTS * width)


def curvature(line: FloatArray) -> FloatArray:
    """Return (N,) curvatures of a line, positive where it turns left."""
    first = np.gradient(line, axis=0)
    second = np.gradient(first, axis=0)
    speed = np.maximum((first**2).sum(axis=1), 1e-12)
    turn = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return np.asarray(turn / (speed * np.sqrt(speed)))


def even(line: FloatArray, spacing: float) -> FloatArray:
    """Return the line with points at even distances."""
    step = np.sqrt((np.diff(line, axis=0) ** 2).sum(axis=1))
    at = np.concatenate(([0.0], np.cumsum(step)))
    wanted = np.linspace(0.0, at[-1], max(round(float(at[-1]) / spacing), 2 * FIXED) + 1)
    return np.stack([np.interp(wanted, at, line[:, axis]) for axis in (0, 1)], axis=1)


def cut_off(line: FloatArray, width: float) -> FloatArray:
    """Return the line without loops whose necks are narrower than the channel."""
    apart = int(3 / POINTS)
    index = 0
    while index < len(line) - apart:
        squared = ((line[index + apart :] - line[index]) ** 2).sum(axis=1)
        near = np.flatnonzero(squared < (1.1 * width) ** 2)
        if len(near):
            line = np.concatenate((line[: index + 1], line[index + apart + near[-1] :]))
        index += 1
    return line


def blocks_near(line: FloatArray, reach: float, x: FloatArray, y: FloatArray) -> NDArray[np.bool_]:
    """Return (rows, cols) whether a place is in a block of cells with places near a line.

    All places within ``reach`` are, and some beyond it.

    Args:
        line: (N, 2) points.
        reach: Largest distance from the nearest of these points.
        x, y: (rows, cols) places of a square grid of any direction.
    """
    corners = np.stack((x[::BLOCK_CELLS, ::BLOCK_CELLS], y[::BLOCK_CELLS, ::BLOCK_CELLS]), axis=-1)
    distance, _ = scipy.spatial.cKDTree(line).query(corners)
    spacing = np.hypot(x[0, 1] - x[0, 0], y[0, 1] - y[0, 0])
    near = distance <= reach + np.sqrt(2.0) * BLOCK_CELLS * spacing
    rows, cols = x.shape
    whole = near.repeat(BLOCK_CELLS, axis=0).repeat(BLOCK_CELLS, axis=1)
    return np.asarray(whole[:rows, :cols])


def channel_of(line: FloatArray, width: float, x: FloatArray, y: FloatArray) -> RiverBed:
    """Return where the points of a ground lie beside a river.

    Args:
        line: (N, 2) points of its middle line.
        width: Width of the channel.
        x, y: Places, in arrays of any shape.
    """
    fine = even(line, FINE * width)
    tree = scipy.spatial.cKDTree(fine)
    distance, near = tree.query(np.stack((x.ravel(), y.ravel()), axis=1))
    ahead = np.gradient(fine, axis=0)
    ahead = ahead / np.maximum(np.sqrt((ahead**2).sum(axis=1)), 1e-12)[:, None]
    dx, dy = x.ravel() - fine[near, 0], y.ravel() - fine[near, 1]
    beside = ahead[near, 0] * dy - ahead[near, 1] * dx
    onward = ahead[near, 0] * dx + ahead[near, 1] * dy
    distance = np.sqrt(np.maximum(distance**2 - onward**2, 0.0))
    side = np.where(beside >= 0, 1.0, -1.0)
    bend = scipy.ndimage.gaussian_filter1d(curvature(fine) * width, 1.2 / FINE)
    shape = x.shape
    return RiverBed(
        (side * distance / (0.5 * width)).reshape(shape),
        (FINE * near + onward / width).reshape(shape),
        bend[near].reshape(shape),
    )


def channel_depth(channel: RiverBed, alternate: float) -> FloatArray:
    """Return the depth below the banks within a channel, in mean depths, 0 at its sides.

    The deepest line lies at the outer side of bends, and point bars at their inner side; in
    straight reaches bars alternate from side to side, some six widths apart.

    Args:
        channel: Where the points lie.
        alternate: Height of alternate bars in mean depths.
    """
    n = np.clip(channel.across, -1.0, 1.0)
    section = 1.5 * (1 - n**6)
    turn = np.clip(1.3 * channel.bend, -0.8, 0.8)
    phase = channel.along / 3.0
    share = phase - np.floor(phase)
    wave = 1.0 - 4.0 * np.abs(share - 0.5)
    straight = 1.0 - np.abs(turn) / 0.8
    return np.asarray(section * (1.0 - turn * n * 1.1) - alternate * straight * wave * n * section)
