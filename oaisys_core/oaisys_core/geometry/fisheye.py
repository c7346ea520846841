"""OpenCV's fisheye lens: from angles to radii in the image, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from oaisys_core.geometry.distortion import MIN_MAGNIFICATION
from oaisys_core.types import FloatArray

TABLE_ANGLES = 4097
"""Angles up to 180 degrees at which a fisheye's radius is tabulated, for its inverse."""


def fisheye_radius(angle_rad: ArrayLike, distortion: tuple[float, ...]) -> FloatArray:
    """Return the radii, in focal lengths, at which a fisheye images directions off its axis.

    The model is OpenCV's ``fisheye`` (J. Kannala and S. Brandt, "A generic camera model and
    calibration method for conventional, wide-angle, and fish-eye lenses", PAMI 28, 2006):
    angle * (1 + k1 angle^2 + k2 angle^4 + k3 angle^6 + k4 angle^8). Inverse: `fisheye_angle_rad`.
    """
    angle = np.asarray(angle_rad, dtype=np.float64)
    k1, k2, k3, k4 = distortion or (0.0,) * 4
    square = angle * angle
    factor = 1 + square * (k1 + square * (k2 + square * (k3 + square * k4)))
    return np.asarray(angle * factor)


def fisheye_slope(angle_rad: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Return the derivative of `fisheye_radius`."""
    k1, k2, k3, k4 = distortion or (0.0,) * 4
    square = angle_rad * angle_rad
    slope = 1 + square * (3 * k1 + square * (5 * k2 + square * (7 * k3 + square * 9 * k4)))
    return np.asarray(slope)


def fisheye_angle_rad(radius: ArrayLike, distortion: tuple[float, ...]) -> FloatArray:
    """Return the angles off the axis of radii in focal lengths; NaN where a lens sees nothing.

    A lens sees up to 180 degrees, or up to where its radius stops growing with the angle.
    """
    radius = np.asarray(radius, dtype=np.float64)
    angles = visible_angles_rad(distortion)
    radii = fisheye_radius(angles, distortion)
    angle = np.interp(radius, radii, angles, right=np.nan)
    # The table's error squares with each of Newton's steps.
    for _ in range(2):
        error = fisheye_radius(angle, distortion) - radius
        angle = angle - error / fisheye_slope(angle, distortion)
    return np.asarray(angle)


def visible_angles_rad(distortion: tuple[float, ...]) -> FloatArray:
    """Return the angles of the table, up to where a lens's radius stops growing."""
    angles = np.linspace(0.0, np.pi, TABLE_ANGLES)
    folds = np.flatnonzero(fisheye_slope(angles, distortion) < MIN_MAGNIFICATION)
    return angles[: folds[0]] if len(folds) else angles


def directions_of(xy: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Return (..., 3) unit vectors of (..., 2) points of the image in focal lengths."""
    radius = np.linalg.norm(xy, axis=-1)
    angle = fisheye_angle_rad(radius, distortion)
    with np.errstate(invalid="ignore"):
        across = np.where(radius > 0, np.sin(angle) / radius, 1.0)
    return np.concatenate((xy * across[..., None], np.cos(angle)[..., None]), axis=-1)
