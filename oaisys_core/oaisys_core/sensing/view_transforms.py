"""Blender's view transforms without Blender: from radiance to pixels.

Those of film are approximated: light is mixed between the colours, its logarithm is bent by a curve
for each colour, and the results are mixed again. The numbers were fitted to what Blender 4.5 shows
of 4,000 colours from 2^-11 to 2^5, from grey to saturated; the mean error is 0.3 bytes of AgX, 0.4
with contrast and 0.1 of Filmic, and 95 % of the values are within 1.4 bytes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import srgb
from oaisys_core.sensing.exposure import meter_ev
from oaisys_core.sensing.render_settings import RenderSettings, ViewTransform

Image = NDArray[np.float32]

BASE_EXPOSURE_EV = 0.6
"""Added to the configured exposure, so that 0 EV shows dry ground in full sun as mid-grey."""

WHITE = {"agx_contrast": 4.0, "agx": 4.0, "filmic": 4.0, "standard": 1.0, "raw": 1.0}
"""Linear value that each view transform shows as white, or hardly darker."""

DARKEST_EV, BRIGHTEST_EV = -12.0, 6.0
"""Stops at the first and the last point of each curve."""


class ExposedImage(NamedTuple):
    """A finished colour image.

    Attributes:
        pixels: (H, W, 3) uint8, as the view transform encodes it.
        exposure_ev: Its exposure in stops, fixed or metered.
        radiance: (H, W, 3) float32 of what is seen, in scene units, before exposure and white
            balance.
    """

    pixels: NDArray[np.uint8]
    exposure_ev: float
    radiance: Image


class Film(NamedTuple):
    """An approximated view transform.

    Attributes:
        before: Shares that red takes of green and blue, green of red and blue, and blue of red and
            green, before the curve.
        after: The same after it.
        curve: Its values at equal steps of stops.
    """

    before: tuple[float, ...]
    after: tuple[float, ...]
    curve: tuple[float, ...]


# fmt: off
FILMS = {
    "agx": Film(
        (0.2149, 0.0576, 0.0835, 0.1085, 0.0624, 0.1306),
        (-0.2579, -0.0874, -0.1057, -0.0264, -0.0922, -0.158),
        (0.0, 0.0003, 0.0014, 0.004, 0.0093, 0.0192, 0.0378, 0.0663, 0.1017, 0.1475, 0.2068, 0.2835,
         0.3798, 0.4944, 0.603, 0.6955, 0.7719, 0.8352, 0.8861, 0.9278, 0.9626, 0.9903, 1.0087,
         1.0087, 1.0101),
    ),
    "agx_contrast": Film(
        (0.198, 0.0604, 0.0812, 0.1094, 0.0612, 0.1277),
        (-0.2242, -0.0997, -0.1077, -0.027, -0.0918, -0.1552),
        (0.0, 0.0, 0.0, 0.0004, 0.0019, 0.0059, 0.0146, 0.034, 0.0671, 0.1106, 0.1714, 0.2535,
         0.3635, 0.501, 0.629, 0.733, 0.8151, 0.8803, 0.9306, 0.9704, 1.0008, 1.0008, 1.0034,
         1.0034, 1.0034),
    ),
    "filmic": Film(
        (0.0023, -0.0006, 0.0005, -0.0002, 0.0003, 0.0001),
        (-0.0027, 0.001, -0.0004, 0.0001, -0.0004, 0.0002),
        (0.0, 0.0056, 0.0108, 0.0185, 0.0293, 0.0446, 0.0659, 0.0953, 0.1349, 0.1872, 0.2539,
         0.3351, 0.429, 0.5304, 0.6315, 0.7263, 0.8086, 0.8751, 0.9253, 0.9608, 0.9841, 0.9974,
         1.0041, 1.0041, 1.0042),
    ),
}
# fmt: on

STEPS = 4096
"""Points of a curve's table, between which its values are not interpolated."""


def exposure_of(radiance: Image, is_surface: NDArray[np.bool_], settings: RenderSettings) -> float:
    """Return the exposure of a picture in stops, fixed or metered.

    Args:
        radiance: (H, W, 3 or 4) scene-linear.
        is_surface: (H, W) pixels that do not show the sky, for the meter.
        settings: How to render.
    """
    if settings.exposure_ev is not None:
        return settings.exposure_ev
    white = WHITE[settings.view_transform]
    return meter_ev(radiance, is_surface, settings.auto_exposure, white, BASE_EXPOSURE_EV)


def show(radiance: Image, view_transform: ViewTransform, exposure_ev: float) -> NDArray[np.uint8]:
    """Return the (H, W, 3) picture of (H, W, 3) radiance."""
    exposed = radiance * np.float32(2.0**exposure_ev)
    if view_transform == "raw":
        shown = exposed
    elif view_transform == "standard":
        shown = srgb(np.clip(exposed, 0, 1))
    else:
        shown = _on_film(exposed, FILMS[view_transform])
    return np.asarray(np.clip(shown, 0, 1) * np.float32(255) + np.float32(0.5), np.uint8)


def _on_film(light: Image, film: Film) -> Image:
    """Return the (H, W, 3) values that a film shows of light."""
    least = np.float32(2.0**DARKEST_EV)
    stops = np.log2(np.maximum(light @ _mixture(film.before).T, least))
    places = (stops - np.float32(DARKEST_EV)) * np.float32(STEPS / (BRIGHTEST_EV - DARKEST_EV))
    at = np.linspace(0, len(film.curve) - 1, STEPS + 1)
    table = np.interp(at, np.arange(len(film.curve)), film.curve).astype(np.float32)
    bent = table[np.minimum(places + np.float32(0.5), STEPS).astype(np.intp)]
    return np.asarray(bent @ _mixture(film.after).T, np.float32)


def _mixture(shares: tuple[float, ...]) -> NDArray[np.float32]:
    """Return the (3, 3) matrix that keeps grey as it is."""
    of_red, of_green, of_blue = shares[:2], shares[2:4], shares[4:]
    rows = (
        (1 - sum(of_red), *of_red),
        (of_green[0], 1 - sum(of_green), of_green[1]),
        (*of_blue, 1 - sum(of_blue)),
    )
    return np.array(rows, np.float32)
