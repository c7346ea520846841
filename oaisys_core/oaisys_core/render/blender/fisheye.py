"""Fisheye cameras by Cycles' lens polynomial, which gives the angle of a radius in the image.

Kannala-Brandt's polynomial gives the radius of an angle. Its inverse is fitted, and what the fit
leaves is resampled, as is a principal point beside the image's centre, which Cycles does not know.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from math import ceil
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.geometry import fisheye_angle_rad
from oaisys_core.types import FloatArray, PinholeIntrinsics

Pixel = TypeVar("Pixel", np.uint8, np.float32)

FIELD_OF_VIEW_RAD = 2 * np.pi
"""Cycles renders nothing beyond half of it off the axis."""

DEGREE = 4
"""Degree of Cycles' polynomial; its constant term is 0."""

FIT_RADII = 1024
"""Radii at which the polynomial is fitted and inverted."""

NEGLIGIBLE_PX = 0.01
"""Images that are displaced by less everywhere are not resampled."""

MARGIN_PX = 2
"""Border that is rendered around an image that is resampled."""


def fisheye_to_render(intrinsics: PinholeIntrinsics) -> PinholeIntrinsics:
    """Return the fisheye that is rendered for a camera: its principal point is in the centre.

    That of a camera which has it there is the camera itself.
    """
    sizes = (intrinsics.width_px, intrinsics.height_px)
    centres = (intrinsics.cx_px, intrinsics.cy_px)
    if all(centre == (size - 1) / 2 for size, centre in zip(sizes, centres, strict=True)):
        return intrinsics
    halves = [
        max(centre + 0.5, size - 0.5 - centre) for size, centre in zip(sizes, centres, strict=True)
    ]
    width_px, height_px = (2 * ceil(half + MARGIN_PX) for half in halves)
    return replace(
        intrinsics,
        width_px=width_px,
        height_px=height_px,
        cx_px=(width_px - 1) / 2,
        cy_px=(height_px - 1) / 2,
    )


def set_fisheye(data: Any, intrinsics: PinholeIntrinsics) -> None:
    """Make Blender's camera a fisheye whose principal point is in the centre of its image.

    Cycles measures radii in millimetres on the sensor, whose width is set already, and wants the
    angle's negative.
    """
    mm_per_focal_length = intrinsics.fx_px * data.sensor_width / intrinsics.width_px
    polynomial = [0.0, *(-lens_polynomial(intrinsics) / mm_per_focal_length**_POWERS).tolist()]
    numbers = {f"fisheye_polynomial_k{power}": value for power, value in enumerate(polynomial)}
    numbers["fisheye_fov"] = FIELD_OF_VIEW_RAD
    settings: dict[str, Any] = {"type": "PANO", "panorama_type": "FISHEYE_LENS_POLYNOMIAL"}
    settings |= {name: float(np.float32(value)) for name, value in numbers.items()}
    for name, value in settings.items():
        # Any assignment has Cycles update the whole scene.
        if getattr(data, name) != value:
            setattr(data, name, value)


_POWERS = np.arange(1, DEGREE + 1)


def lens_polynomial(intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return the `DEGREE` coefficients of the angle by powers 1 to 4 of the radius.

    Radii are in focal lengths. The polynomial fits best, in least squares over the radii of the
    image, to the inverse of the camera's model.
    """
    radii = np.linspace(0.0, _most_radius(intrinsics), FIT_RADII)
    angles = fisheye_angle_rad(radii, intrinsics.distortion)
    # At the rim, beyond what the image shows, a lens may see nothing.
    seen = np.isfinite(angles)
    columns = radii[seen, None] ** _POWERS
    fitted, *_ = np.linalg.lstsq(columns, angles[seen], rcond=None)
    return np.asarray(fitted, np.float64)


def _most_radius(intrinsics: PinholeIntrinsics) -> float:
    """Return the radius of the image's farthest corner, in focal lengths."""
    u = max(intrinsics.cx_px + 0.5, intrinsics.width_px - 0.5 - intrinsics.cx_px)
    v = max(intrinsics.cy_px + 0.5, intrinsics.height_px - 0.5 - intrinsics.cy_px)
    return float(np.hypot(u / intrinsics.fx_px, v / intrinsics.fy_px))


def fisheye_image(
    image: NDArray[Pixel], rendered: PinholeIntrinsics, intrinsics: PinholeIntrinsics
) -> NDArray[Pixel]:
    """Return a camera's image of one that its `fisheye_to_render` sees."""
    source = _source_pixels(rendered, intrinsics)
    if source is None:
        return image
    return np.asarray(cv2.remap(image, *source, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))


@lru_cache(maxsize=4)
def _source_pixels(
    rendered: PinholeIntrinsics, intrinsics: PinholeIntrinsics
) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """Return (H, W) columns and rows in Cycles' image; None if they are the camera's own."""
    columns, rows = np.arange(intrinsics.width_px), np.arange(intrinsics.height_px)
    x = (columns[None, :] - intrinsics.cx_px) / intrinsics.fx_px
    y = (rows[:, None] - intrinsics.cy_px) / intrinsics.fy_px
    radius = np.hypot(x, y)
    radii = np.linspace(0.0, 1.05 * _most_radius(rendered), FIT_RADII * 16)
    angles = radii[:, None] ** _POWERS @ lens_polynomial(rendered)
    found = np.interp(fisheye_angle_rad(radius, intrinsics.distortion), angles, radii)
    scale = np.where(radius > 0, found / np.maximum(radius, 1e-12), 1.0)
    u = x * scale * rendered.fx_px + rendered.cx_px
    v = y * scale * rendered.fy_px + rendered.cy_px
    if rendered == intrinsics:
        displaced_px = max(np.abs(u - columns).max(), np.abs(v - rows[:, None]).max())
        if displaced_px < NEGLIGIBLE_PX:
            return None
    return u.astype(np.float32), v.astype(np.float32)
