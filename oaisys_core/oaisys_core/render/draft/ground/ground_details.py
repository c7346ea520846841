"""What lies over the ground's layers: fines around things, tracks of wheels, water's wet banks."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.contact_map import ContactMap
from oaisys_core.render.draft.appearance import Floats, put, take
from oaisys_core.render.draft.ground.texture_atlas import sample
from oaisys_core.render.shading.looks import (
    DARK_FROM,
    DARKEST,
    FINES_BRIGHTNESS,
    FINES_FROM,
    FINES_ROUGHNESS,
    MAX_FINES,
    TRACK_DARKENING,
    WET_DARKENING,
)
from oaisys_core.types import FloatArray


class FinesColor(NamedTuple):
    """The colours of fines at N points: the layers' mean colours.

    Attributes:
        weights: (N, L) of the layers.
        means: (L, 3) of their colours, linear.
    """

    weights: Floats
    means: Floats

    def at(self, points: NDArray[np.intp]) -> Floats:
        """Return the (P, 3) colours at some of the points."""
        return take(self.weights, points) @ self.means


def add_contact(
    contact: ContactMap,
    driven: tuple[float, ...],
    xy_m: FloatArray,
    fines: FinesColor | None,
    found: tuple[Floats, Floats, Floats],
) -> None:
    """Show fines around things, and tracks.

    Args:
        contact: Where they are.
        driven: How much of its way each rover has driven.
        xy_m: (N, 2) points.
        fines: Colours of fines there; None only darkens the contact.
        found: (N, 3) colours and leans and (N,) roughness, which are changed.
    """
    color, lean, roughness = found
    x0, y0, x1, y1 = contact.extent_m
    rows, columns = contact.share.shape
    x = ((xy_m[:, 0] - x0) * (columns / (x1 - x0)) - 0.5).astype(np.float32)
    y = ((xy_m[:, 1] - y0) * (rows / (y1 - y0)) - 0.5).astype(np.float32)
    near = sample(contact.share, x, y, cv2.BORDER_CONSTANT)
    if contact.passed is not None:
        _darken_tracks(sample(contact.passed, x, y, cv2.BORDER_CONSTANT), driven, color)
    seen = np.flatnonzero(near)
    if not len(seen):
        return
    share = near[seen].astype(np.float32) * np.float32(1 / 255)
    dark = np.clip((share - DARK_FROM) / (1 - DARK_FROM), 0, 1)
    before = take(color, seen)
    if fines is None:
        put(color, seen, before * (1 - dark * (1 - DARKEST))[:, None])
        return
    part = np.minimum(share / FINES_FROM, 1) * np.float32(MAX_FINES)
    shown = fines.at(seen) * (FINES_BRIGHTNESS + dark * (DARKEST - FINES_BRIGHTNESS))[:, None]
    put(color, seen, before + part[:, None] * (shown - before))
    put(lean, seen, take(lean, seen) * (1 - part)[:, None])
    roughness[seen] += part * (FINES_ROUGHNESS - roughness[seen])


def darken_wet(
    bank_m: tuple[float, float],
    extent_m: tuple[float, float, float, float],
    points_m: FloatArray,
    color: Floats,
) -> None:
    """Darken colours at (N, 3) points, in place, up to the first height, and less up to the second.

    There is no water beyond ``extent_m``.
    """
    low_m, high_m = bank_m
    x0, y0, x1, y1 = extent_m
    share = np.clip((high_m - points_m[:, 2]) / max(high_m - low_m, 1e-3), 0, 1)
    share[((points_m[:, :2] < (x0, y0)) | (points_m[:, :2] > (x1, y1))).any(axis=1)] = 0
    color *= (1 - WET_DARKENING * share).astype(np.float32)[:, None]


def _darken_tracks(passed: NDArray[np.uint8], driven: tuple[float, ...], color: Floats) -> None:
    """Darken, in place, what wheels have passed so far."""
    for end, value in zip(driven, passed.T, strict=False):
        is_track = (value > 0) & (value < end * 255)
        color[is_track] *= np.float32(1 - TRACK_DARKENING)
