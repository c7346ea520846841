"""The model of a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oaisys_core.types.arrays import FloatArray

MAX_IMAGE_PX = 100_000_000
"""Largest number of pixels of an image."""

PLUMB_BOB = "plumb_bob"
"""ROS's name of a pinhole camera with Brown-Conrady distortion of five coefficients."""

EQUIDISTANT = "equidistant"
"""ROS's name of OpenCV's fisheye camera (Kannala-Brandt) of four coefficients."""


@dataclass(frozen=True)
class PinholeIntrinsics:
    """A pinhole or fisheye camera in OpenCV's convention: pixel centres at integers.

    Attributes:
        width_px, height_px: Image size.
        fx_px, fy_px: Focal lengths in pixels; of a fisheye, pixels per radian on the axis.
        cx_px, cy_px: Principal point; (319.5, 239.5) is the centre of a 640x480 image.
        distortion: Brown-Conrady coefficients (k1, k2, p1, p2, k3) in the order of OpenCV and of
            ROS's ``plumb_bob``; of a fisheye, the coefficients (k1, k2, k3, k4) of OpenCV's
            ``fisheye``; empty for none.
        distortion_model: `PLUMB_BOB`, or `EQUIDISTANT` for a fisheye.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()
    distortion_model: str = PLUMB_BOB

    @property
    def is_fisheye(self) -> bool:
        """Whether it is a fisheye, whose depth images have ranges along the rays."""
        return self.distortion_model == EQUIDISTANT

    @property
    def is_rectilinear(self) -> bool:
        """Whether it images straight lines as straight lines: a pinhole without distortion."""
        return not self.is_fisheye and not any(self.distortion)

    @property
    def K(self) -> FloatArray:  # noqa: N802 - the field's name for the camera matrix
        """The 3x3 camera matrix."""
        return np.array(
            [[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]]
        )
