"""Colours for images of labels and of instance ids, which few viewers can show as they are."""

from __future__ import annotations

import colorsys

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import INSTANCE
from oaisys_mapping.voxels.semantic_fusion import class_colors

_MULTIPLIER = 0x9E3779B1
"""Odd, and near the golden section of 2^32: neighbouring ids get far hues."""


def color_ids(modality: str, ids: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Return the (H, W, 3) RGB image of an (H, W) image of labels or of instance ids.

    A label has the colour that the mapper's mesh gives its class: by its id in the legend, grey
    where it is unlabelled. An instance has the colour of its id's hash, black where there is none.
    An id has the same colour in all images, worlds and runs.
    """
    known, place = np.unique(ids, return_inverse=True)
    colors = (
        _instance_colors(known) if modality == INSTANCE else class_colors(known.astype(np.uint16))
    )
    return np.asarray(colors[place.reshape(ids.shape)])


def _instance_colors(ids: NDArray[np.generic]) -> NDArray[np.uint8]:
    colors = [_instance_color(int(one)) for one in ids]
    return np.array(colors, np.uint8).reshape(-1, 3)


def _instance_color(instance_id: int) -> tuple[int, int, int]:
    if instance_id == 0:
        return 0, 0, 0
    mixed = (instance_id * _MULTIPLIER) & 0xFFFFFFFF
    hue = (mixed >> 16) / 65536
    saturation = 0.5 + (mixed >> 8 & 0xFF) / 510
    value = 0.6 + (mixed & 0xFF) / 638
    red, green, blue = (round(255 * part) for part in colorsys.hsv_to_rgb(hue, saturation, value))
    return red, green, blue
