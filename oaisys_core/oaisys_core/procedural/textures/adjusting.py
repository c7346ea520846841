"""Changes of a texture set: its colour and the strength of its relief."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from oaisys_core.color import encode_srgb, linear
from oaisys_core.procedural.textures.fields import normals_from_height
from oaisys_core.procedural.textures.normal_maps import decode_normals, encode_normals
from oaisys_core.scene.terrain_material import PbrMaps
from oaisys_core.types import FloatArray

CHANNELS = ("red", "green", "blue")
ALL_CHANNELS = "combined"

Curves = Mapping[str, Sequence[tuple[float, float]]]
"""Points of tone curves by ``combined``, ``red``, ``green`` and ``blue``."""


@dataclass(frozen=True)
class ColorChange:
    """A change of a colour map, in linear light.

    Attributes:
        hue_deg: Rotation of the hue.
        saturation, value: Factors on saturation and value.
        curves: Tone curves, applied first: the combined one, then those of the channels.
    """

    hue_deg: float = 0.0
    saturation: float = 1.0
    value: float = 1.0
    curves: Curves = field(default_factory=dict)


def recolor(maps: PbrMaps, change: ColorChange) -> PbrMaps:
    """Return a texture set with changed colour, or itself if nothing changes."""
    import cv2

    has_curves = any(change.curves.values())
    is_turned = (change.hue_deg % 360, change.saturation, change.value) != (0, 1, 1)
    if not has_curves and not is_turned:
        return maps
    color = np.stack(
        [
            _tone(change.curves, name).astype(np.float32)[maps.color_srgb[..., index]]
            for index, name in enumerate(CHANNELS)
        ],
        axis=-1,
    )
    if is_turned:
        hsv = cv2.cvtColor(color, cv2.COLOR_RGB2HSV)
        hsv[..., 0] = (hsv[..., 0] + change.hue_deg) % 360
        hsv[..., 1] = np.minimum(hsv[..., 1] * change.saturation, 1)
        hsv[..., 2] *= change.value
        color = np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB), np.float32)
    return replace(maps, color_srgb=encode_srgb(color))


def with_relief(maps: PbrMaps, displacement_m: float | None, strength: float) -> PbrMaps:
    """Return a texture set with changed normals, or itself if nothing changes.

    Args:
        maps: The texture set before the change.
        displacement_m: Height of the full range of the height map, from which new normals are
            derived; None keeps the normals.
        strength: Factor on their slopes.
    """
    if displacement_m is not None:
        normal = normals_from_height(maps.height, displacement_m * strength, maps.tile_m)
        return replace(maps, normal_gl=normal)
    if strength == 1:
        return maps
    slopes = decode_normals(maps.normal_gl)
    slopes[..., :2] *= np.float32(strength)
    unit = slopes / np.linalg.norm(slopes, axis=-1, keepdims=True)
    return replace(maps, normal_gl=encode_normals(unit))


def _tone(curves: Curves, channel: str) -> FloatArray:
    """Return (256,) linear values of a channel's sRGB bytes after its curves."""
    values = linear(np.arange(256) / 255)
    for points in (curves.get(ALL_CHANNELS, ()), curves.get(channel, ())):
        if points:
            # Later points replace earlier ones with the same input.
            through = dict(sorted(({0.0: 0.0, 1.0: 1.0} | dict(points)).items()))
            curve = scipy.interpolate.PchipInterpolator(list(through), list(through.values()))
            values = curve(values)
    return np.asarray(values)
