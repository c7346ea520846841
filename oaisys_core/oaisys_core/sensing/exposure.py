"""Automatic exposure: a meter that reads each picture by itself, as a camera's does.

The exposure depends on the scene-linear picture alone, never on earlier ones, so that a view
rendered again looks the same.

* The mean luminance of what is seen is exposed to a target, as by reflected-light meters
  (ISO 2720). A mean of linear values is hardly changed by noise, so pictures of few and of many
  samples per pixel get the same exposure.
* The sky counts little, so that neither a bright nor a black one decides how the ground looks.
* Dark ground is shown darker than bright ground, as far as the meter is told to: by itself it would
  show black sand and snow alike, as reflected-light meters do and incident-light meters do not.
* Shade that no light reaches counts little beside ground that is lit.
* Only a small share of the picture may be brighter than white, as in the automatic exposure of
  rovers' engineering cameras (Maki et al. 2003, Mars Exploration Rover Engineering Cameras).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite, log2

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import LUMINANCE
from oaisys_core.errors import RenderError

Image = NDArray[np.float32]

CELL_PX = 4
"""Edge length of the squares whose means are metered."""

SKY_WEIGHT = 0.02
"""Weight of a pixel of the sky beside one of the ground; alone in the picture, the sky decides."""

SATURATION_EV, PASSES = 4.0, 2
"""Stops above the mean at which a lamp or a reflection of the sun counts no more, and how often the
mean is taken again for that."""

DARKEST_SKY_EV, DARKEST_GROUND_EV = -4.0, -12.0
"""Least that sky and ground count for, in stops beside each other: a black sky says nothing."""

SHADE_EV, SHADE_WEIGHT = (-5.0, -7.0), 0.1
"""Stops below lit ground between which ground begins to count as shade without any light, and from
which it has this weight: on the Moon, it would leave the little that is lit white."""

USUAL_ALBEDO, LEAST_ALBEDO = 0.2, 0.01
"""Albedo of ground that is exposed to the target itself, and the least that ground counts for."""

MAX_DARKENING_EV, MAX_DARKENING_BY_SKY_EV = 2.0, 1.0
"""Stops by which bright ground may darken a picture, and bright sky and ground together: a wood
before bright clouds would be black."""

DIGITS = 3
"""Decimal digits of an exposure in stops: 0.001 changes no byte by more than one."""


@dataclass(frozen=True)
class AutoExposure:
    """How pictures are metered; see `AutoExposureConfig`."""

    target: float = 0.25
    compensation_ev: float = 0.0
    min_ev: float = -6.0
    max_ev: float = 8.0
    bright_share: float = 0.02
    albedo_share: float = 0.0

    def for_ground(self, albedo: float) -> AutoExposure:
        """Return the meter of a world whose ground has a mean albedo, as luminance from 0 to 1."""
        relative = max(albedo, LEAST_ALBEDO) / USUAL_ALBEDO
        return replace(self, target=self.target * relative**self.albedo_share, albedo_share=0.0)


STANDARD_METER = AutoExposure()


def meter_ev(
    radiance: Image,
    is_surface: NDArray[np.bool_],
    meter: AutoExposure,
    white: float = 1.0,
    base_ev: float = 0.0,
) -> float:
    """Return the exposure of a picture in stops, beyond ``base_ev`` and within the meter's limits.

    Args:
        radiance: (H, W, 3 or 4) scene-linear picture.
        is_surface: (H, W) pixels that do not show the sky.
        meter: Target and limits.
        white: Linear value that is shown as white.
        base_ev: Stops by which the picture is brightened in any case.

    Raises:
        RenderError: Some of the radiance is not finite; the picture would be black.
    """
    luminance = _luminance(radiance)
    surface = is_surface.astype(np.float32)
    if not isfinite(float(luminance.mean())):
        wrong = int(np.count_nonzero(~np.isfinite(luminance)))
        raise RenderError(f"radiance is not finite in {wrong} of {luminance.size} pixels")
    mean = _mean_of_both(luminance, surface)
    if mean <= 0.0:
        return meter.max_ev
    exposure_ev = log2(meter.target / mean)
    limits_ev = [exposure_ev]
    for shown, most_ev in (
        (luminance * surface, MAX_DARKENING_EV),
        (luminance, MAX_DARKENING_BY_SKY_EV),
    ):
        bright = float(np.quantile(_of_cells(shown), 1.0 - meter.bright_share))
        if bright > 0.0:
            limits_ev.append(max(log2(white / bright), exposure_ev - most_ev))
    exposure_ev = min(limits_ev) + meter.compensation_ev - base_ev
    return round(min(max(exposure_ev, meter.min_ev), meter.max_ev), DIGITS)


def _luminance(radiance: Image) -> Image:
    import cv2

    rgb = np.ascontiguousarray(radiance[..., :3])
    luminance = cv2.transform(rgb, np.array([LUMINANCE], np.float32)).reshape(rgb.shape[:2])
    return np.asarray(np.maximum(luminance, 0.0), np.float32)


def _of_cells(image: Image) -> Image:
    """Return the means of squares of pixels."""
    import cv2

    height, width = image.shape
    size = max(width // CELL_PX, 1), max(height // CELL_PX, 1)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)


def _mean_of_both(luminance: Image, surface: Image) -> float:
    """Return the geometric mean of the ground's and the sky's mean luminance, by their weights."""
    area = float(surface.mean())
    ground, sky = _mean(luminance, surface), _mean(luminance, 1 - surface)
    ground = max(ground, sky * 2.0**DARKEST_GROUND_EV)
    sky = max(sky, ground * 2.0**DARKEST_SKY_EV)
    if ground <= 0.0:
        return 0.0
    share = area / (area + SKY_WEIGHT * (1 - area))
    return float(ground**share * sky ** (1 - share))


def _mean(luminance: Image, shown: Image) -> float:
    """Return the mean where something is shown, in which very bright cells count as saturated."""
    weights = _of_cells(shown)
    if not weights.any():
        return 0.0
    cells = _of_cells(luminance * shown) / np.maximum(weights, np.float32(1e-6))
    mean = float(np.average(cells, weights=weights))
    for _ in range(PASSES):
        saturated = np.minimum(cells, np.float32(mean * 2.0**SATURATION_EV))
        mean = float(np.average(saturated, weights=weights))
    if mean <= 0.0:
        return 0.0
    return float(np.average(saturated, weights=weights * _lit(saturated, weights)))


def _lit(cells: Image, weights: Image) -> Image:
    """Return weights of cells: 1 where they are lit, `SHADE_WEIGHT` in shade without any light."""
    # However little is lit, the mean of luminance weighted by itself is that of what is lit.
    lit = float(np.average(cells, weights=weights * cells))
    first, last = SHADE_EV
    below_ev = np.log2(np.maximum(cells / np.float32(lit), np.float32(2.0**last)))
    share = np.clip((below_ev - last) / (first - last), 0.0, 1.0)
    return np.asarray(SHADE_WEIGHT + (1.0 - SHADE_WEIGHT) * share, np.float32)
