"""The kinds of images and scans that sensors deliver."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np

from oaisys_core import extensions
from oaisys_core.errors import did_you_mean

RGB = "rgb"

DEPTH = "depth"

DEPTH_TRUE = "depth_true"

SEMANTIC_0 = "semantic_0"

INSTANCE = "instance"

RANGE = "range"

RANGE_TRUE = "range_true"

DISTANCES = frozenset({DEPTH, DEPTH_TRUE, RANGE, RANGE_TRUE})
"""Modalities whose pixels are distances from the camera in metres."""

NORMAL = "normal"

FLOW = "flow"

ALBEDO = "albedo"

DISPARITY = "disparity"

RADIANCE = "radiance"

MONO16, RGB16 = "mono16", "rgb16"

BAYER = {
    "bayer_rggb16": "rggb",
    "bayer_bggr16": "bggr",
    "bayer_gbrg16": "gbrg",
    "bayer_grbg16": "grbg",
}
"""Mosaics of filters: the bands of the first two rows' first two pixels."""

DIGITAL = frozenset({MONO16, RGB16, *BAYER})
"""Digital numbers of an image sensor; the names are those of ROS's image encodings."""

COLORS = frozenset({RGB, ALBEDO})
"""Modalities that are pictures of 8 bits."""

LIT = DIGITAL | {RGB, RADIANCE}
"""Modalities that depend on light."""

RENDERED = LIT | {ALBEDO}
"""Modalities that are rendered; all others are cast, and depend neither on light nor on quality."""


def is_rendered(modality: str, quality: str, passes: Collection[str] | None) -> bool:
    """Return whether samples have the images that a camera has of a modality.

    Args:
        modality: Its name.
        quality: ``render.quality``; ``geometry`` has no colour.
        passes: ``render.passes``; None for all.
    """
    is_left_out = quality == "geometry" and modality in RENDERED
    return not is_left_out and (passes is None or modality in passes)


POINTS = "points"
"""Modality of lidars, whose data are points rather than an image."""


class ModalitySpec(NamedTuple):
    """The type of a modality's pixels; ``channels`` is 1 for (H, W) images."""

    dtype: np.dtype[Any]
    channels: int


_MODALITIES: Mapping[str, ModalitySpec] = {
    RGB: ModalitySpec(np.dtype(np.uint8), 3),
    DEPTH: ModalitySpec(np.dtype(np.float32), 1),
    DEPTH_TRUE: ModalitySpec(np.dtype(np.float32), 1),
    RANGE: ModalitySpec(np.dtype(np.float32), 1),
    RANGE_TRUE: ModalitySpec(np.dtype(np.float32), 1),
    INSTANCE: ModalitySpec(np.dtype(np.uint32), 1),
    NORMAL: ModalitySpec(np.dtype(np.float32), 3),
    FLOW: ModalitySpec(np.dtype(np.float32), 2),
    ALBEDO: ModalitySpec(np.dtype(np.uint8), 3),
    DISPARITY: ModalitySpec(np.dtype(np.float32), 1),
    RADIANCE: ModalitySpec(np.dtype(np.float32), 3),
    **{
        each: ModalitySpec(np.dtype(np.uint16), 3 if each == RGB16 else 1)
        for each in sorted(DIGITAL)
    },
}

_SEMANTIC = ModalitySpec(np.dtype(np.uint16), 1)


def modality_spec(modality: str) -> ModalitySpec:
    """Return the type of a modality's pixels.

    * ``rgb``: sRGB colour. ``albedo``: sRGB-encoded reflectance, without light and effects.
    * ``depth``: planar z in metres, of a fisheye the same as ``range``; ``range``: metres along the
      ray; ``+inf`` where nothing is hit. Faults of the sensors change both; ``depth_true`` and
      ``range_true`` are the same without faults.
    * ``semantic_0`` to ``semantic_9``: label ids by level. ``instance``: object ids, 0 for none.
    * ``normal``: unit normals in the optical frame, towards the camera; 0 where nothing is hit.
    * ``flow``: motion (du, dv) in pixels since the sensor's previous sample of the surface that a
      pixel shows; NaN where it was not in front of the camera or where a lens's distortion does
      not hold (twice as far from the axis as the corners, or folded), or without a previous sample.
    * ``radiance``: W/(m² sr) in the bands red, green and blue, linear and never clipped; see
      `oaisys_core.procedural.environment.radiometry`.
    * ``mono16``, ``rgb16``, ``bayer_rggb16`` and the other mosaics: digital numbers of the camera's
      image sensor, see `oaisys_core.sensing.digitizing`.
    * ``disparity``: distance in pixels between the images of a stereo pair; 0 where nothing is hit.

    Raises:
        KeyError: There is no such modality.
    """
    if semantic_level(modality) is not None:
        return _SEMANTIC
    if extensions.is_installed(extensions.PASSES, modality, _MODALITIES):
        spec: ModalitySpec = extensions.load(extensions.PASSES, modality).spec
        return spec
    return _MODALITIES[modality]


def modality_expectation(received: str) -> str:
    """Return the text after "expected" in the error about a modality that does not exist."""
    levels = [f"semantic_{level}" for level in range(10)]
    passes = extensions.names(extensions.PASSES)
    hint = did_you_mean(received, [*_MODALITIES, *levels, *passes])
    built_in = ", ".join(_MODALITIES)
    installed = f"{', '.join(sorted(passes))}" if passes else "none is installed"
    return f"{built_in}, semantic_0 to semantic_9, or an installed pass ({installed}){hint}"


def semantic_level(modality: str) -> int | None:
    """Return the level of ``semantic_N``, None for any other modality."""
    match = re.fullmatch(r"semantic_([0-9])", modality)
    return None if match is None else int(match[1])
