"""OpenCV's polynomial of radial and tangential distortion, and its inverse."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from oaisys_core.types import FloatArray

INVERSE_TOLERANCE = 1e-12
"""Largest error, at z = 1, of the inverse of the distortion."""

INVERSE_STEPS = 8

NEWTON_STEPS, FOLD_STEPS = 6, 18
"""Steps from the centre of the lens to a pixel, Newton steps at the pixel, and most further ones
beside a fold, where each of them only halves the error."""

INVERSE_CHUNK = 16384
"""Pixels that are processed at once, so that intermediate arrays fit into the CPU cache."""

INVERSE_HALVINGS = 10
"""How often a step of Newton's method that leads beyond a fold is halved."""

MIN_MAGNIFICATION = 1e-3
"""A distortion that scales areas by less than this anywhere in the image is refused.

The same holds for the slope of a fisheye's radius over the angle.
"""


def distort(xy: ArrayLike, distortion: tuple[float, ...]) -> FloatArray:
    """Return (..., 2) distorted coordinates at z = 1 of (..., 2) undistorted ones (Brown-Conrady).

    Inverse: `undistort`. ``distortion`` is (k1, k2, p1, p2, k3), or empty for none.
    """
    xy = np.asarray(xy, dtype=np.float64)
    if not any(distortion):
        return xy
    x, y = xy[..., 0], xy[..., 1]
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    distorted_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    distorted_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack((distorted_x, distorted_y), axis=-1)


def undistort(xy: ArrayLike, distortion: tuple[float, ...]) -> FloatArray:
    """Return (..., 2) undistorted coordinates at z = 1 of (..., 2) distorted ones; NaN if none.

    Newton's method starts at the centre of the lens and approaches the pixel in small steps, so
    that it does not jump to another root. The result is exact to `INVERSE_TOLERANCE`.
    """
    xy = np.asarray(xy, dtype=np.float64)
    if not any(distortion):
        return xy
    targets = xy.reshape(-1, 2)
    found = np.empty_like(targets)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for begin in range(0, len(targets), INVERSE_CHUNK):
            chunk = slice(begin, begin + INVERSE_CHUNK)
            found[chunk] = _undistort_chunk(targets[chunk], distortion)
    return found.reshape(xy.shape)


def _undistort_chunk(target: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    found = np.zeros_like(target)
    steps = [(step + 1) / INVERSE_STEPS for step in range(INVERSE_STEPS)]
    for share in [share for share in steps for _ in range(2)] + [1.0] * NEWTON_STEPS:
        found = _newton_step(found, share * target, distortion)
    for _ in range(FOLD_STEPS):
        error = np.abs(distort(found, distortion) - target).max(axis=1)
        far = np.flatnonzero(~(error < INVERSE_TOLERANCE))
        if not len(far):
            break
        found[far] = _newton_step(found[far], target[far], distortion)
    error = np.abs(distort(found, distortion) - target).max(axis=1)
    is_valid = (area_scale(found, distortion) > MIN_MAGNIFICATION) & (error < INVERSE_TOLERANCE)
    found[~is_valid] = np.nan
    return found


def _newton_step(
    found: FloatArray, target: FloatArray, distortion: tuple[float, ...]
) -> FloatArray:
    """Return undistorted points nearer to (N, 2) distorted ones, on this side of a fold."""
    a, b, d = _magnification(found, distortion)
    u, v = (distort(found, distortion) - target).T
    step = np.column_stack((d * u - b * v, a * v - b * u)) / (a * d - b * b)[:, None]
    for _ in range(INVERSE_HALVINGS):
        folded = ~(area_scale(found - step, distortion) > MIN_MAGNIFICATION)
        if not folded.any():
            break
        step[folded] /= 2
    return np.asarray(found - step)


def area_scale(xy: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Return the (N,) factors by which `distort` scales areas; not above 0 beyond a fold."""
    a, b, d = _magnification(xy, distortion)
    return a * d - b * b


def _magnification(
    xy: FloatArray, distortion: tuple[float, ...]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the (N,) entries xx, xy = yx and yy of the derivative of `distort`."""
    x, y = xy[:, 0], xy[:, 1]
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
    xx = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
    yy = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
    return xx, x * y * slope + 2 * p1 * x + 2 * p2 * y, yy
