"""Takes a view into voxels: weighted means of projective distance, colour and classes.

As in Curless and Levoy, SIGGRAPH 1996. Open3D's own integration knows no weights, no rays that hit
nothing and no classes; this one does, with numpy over the same buffers, and takes no longer. Blocks
are worked on in parts that fit into a processor's cache; no two parts share a voxel, so the result
does not depend on how many threads there are.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_mapping.voxels.blocks import BLOCK_VOXELS, VOXELS, Coordinates, Slots
from oaisys_mapping.voxels.padded_images import PaddedImages
from oaisys_mapping.voxels.semantic_fusion import fuse_classes

PART_BLOCKS = 192
"""Blocks that are worked on at a time: an intermediate result has 400 kB."""

FULL_SHARE, FADED_SHARE = 1 / 3, 1 / 2
"""Depths behind the surface, in truncations, up to which an observation counts in full, and from
which on it is only `ASSUMED`: what a view cannot see is another's to say. (In Oleynikova et al.,
"Voxblox", IROS 2017, what is behind fades from a voxel on to the truncation.) Where it did not,
views that see a rock's top outvoted those that see its foot: on ten worlds of the demo's, in all
16 spots of truth that two views saw were 10 to 12 cm from the map; three are left so, and one with
what is taken for solid."""

ASSUMED = 1e-3
"""What an observation counts in voxels that are hidden behind what the ray hit: they are taken for
solid until a view tells otherwise, so that a face at grazing rays has two sides. As in hole
filling by Curless and Levoy, but only close behind a surface."""

FREE_COUNTS = 1 / 3
"""What an observation counts a truncation and more in front of what the ray hit; in full up to
`FULL_SHARE` of it. Beside an edge, rays pass on their way to what lies far behind: together with
truncation that would outweigh those that meet the surface. A single free ray still clears."""

CLOSE_VOXELS = 0.3
"""Distance in front of the surface at which a label counts half."""

THREADS = min(8, os.cpu_count() or 1)

POOL = ThreadPoolExecutor(THREADS, thread_name_prefix="voxels")

VOXEL_BITS = VOXELS.bit_length() - 1

_TINY = np.float32(1e-30)
_FOUR = np.complex128
"""Moves four float32 at a time."""


@dataclass(frozen=True)
class IntegrationRules:
    """What holds for all views.

    Attributes:
        truncation_m: Distance that counts as 1.
        described_m: Distance in front of the surface up to which colour and classes are kept: only
            voxels beside the surface are asked for them.
        max_weight: Weight beyond which a voxel's does not grow.
        reach_m: Distance behind the surface up to which voxels are told about.
    """

    voxel_size_m: float
    truncation_m: float
    described_m: float
    max_weight: float
    reach_m: float


def voxel_offsets() -> NDArray[np.int64]:
    """Return the (`VOXELS`, 3) places of a block's voxels in it, x first."""
    number = np.arange(VOXELS)
    return np.column_stack(
        (number % BLOCK_VOXELS, number // BLOCK_VOXELS % BLOCK_VOXELS, number // BLOCK_VOXELS**2)
    )


def integrate_view(
    arrays: Mapping[str, NDArray[Any]],
    coordinates: Coordinates,
    slots: Slots,
    seen: PaddedImages,
    rules: IntegrationRules,
) -> NDArray[np.bool_]:
    """Take a view into blocks; return (N,) which of them it said something about."""
    parts = range(0, len(slots), PART_BLOCKS)
    work = partial(_fuse_part, arrays, coordinates, slots, seen, rules)
    changed = list(POOL.map(work, parts))
    return np.concatenate(changed) if changed else np.zeros(0, bool)


def _fuse_part(
    arrays: Mapping[str, NDArray[Any]],
    coordinates: Coordinates,
    slots: Slots,
    seen: PaddedImages,
    rules: IntegrationRules,
    first: int,
) -> NDArray[np.bool_]:
    slots = slots[first : first + PART_BLOCKS]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        pixels, z_m, (least_m, most_m) = _projected(
            coordinates[first : first + PART_BLOCKS], seen, rules
        )
        depth_m = seen.depth_m.take(pixels)
        ahead_m = depth_m - z_m
        is_told = ahead_m > -rules.reach_m
        if most_m > seen.max_range_m:
            is_told &= (z_m <= seen.max_range_m) | (depth_m < np.inf)
        if least_m <= 0:
            is_told &= z_m > 0
    distance = ahead_m * np.float32(1 / rules.truncation_m)
    told = _counts(distance, is_told)
    np.clip(distance, -1, 1, out=distance)
    if seen.weight is not None:
        told *= seen.weight.take(pixels)
    is_near = ahead_m < rules.described_m
    is_near &= ahead_m > -rules.truncation_m
    is_near &= is_told
    near = np.flatnonzero(is_near)
    closeness = None
    if seen.labels is not None:
        closeness = _closeness(ahead_m.take(near) / rules.voxel_size_m)
    _average(arrays, slots, distance, told, rules)
    voxels = slots.astype(np.int64).take(near >> VOXEL_BITS) << VOXEL_BITS
    voxels += near & (VOXELS - 1)
    _describe(arrays, voxels, pixels.take(near), told.take(near), seen, closeness)
    return np.asarray(is_told.view(np.uint64).any(axis=1))


def _counts(distance: NDArray[np.float32], is_told: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return what an observation counts in voxels so many truncations in front of a surface."""
    behind = distance * np.float32(1 / (FADED_SHARE - FULL_SHARE))
    behind += np.float32(FADED_SHARE / (FADED_SHARE - FULL_SHARE))
    np.maximum(behind, np.float32(ASSUMED), out=behind)
    slope = (1 - FREE_COUNTS) / (1 - FULL_SHARE)
    ahead = distance * np.float32(-slope)
    ahead += np.float32(1 + slope * FULL_SHARE)
    np.clip(ahead, np.float32(FREE_COUNTS), 1, out=ahead)
    counts = np.minimum(behind, ahead, out=behind)
    counts *= is_told
    return counts


def _closeness(voxels_ahead: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return what labels count in voxels that lie so far in front of what the ray hit.

    All of it behind the surface, less and less in front: beside a step, rays pass on their way to
    what lies further down, and would outvote the step's own class. The demo's rocks, seen from
    above, come out with an IoU of 0.902 so, and with 0.855 where all counts alike.
    """
    ahead = np.maximum(voxels_ahead, 0)
    return np.asarray(CLOSE_VOXELS**2 / (CLOSE_VOXELS**2 + np.square(ahead)), np.float32)


def _projected(
    coordinates: Coordinates, seen: PaddedImages, rules: IntegrationRules
) -> tuple[NDArray[np.int32], NDArray[np.float32], tuple[float, float]]:
    """Return (N, `VOXELS`) flat pixels and depths of all voxels, and the depths' extremes."""
    matrix, offset = seen.to_pixel
    base = (rules.voxel_size_m * BLOCK_VOXELS * coordinates) @ matrix.T + offset
    around = ((rules.voxel_size_m * voxel_offsets()) @ matrix.T).astype(np.float32)
    u, v, z_m = (base[:, i, None].astype(np.float32) + around[None, :, i] for i in range(3))
    inverse = np.float32(1) / z_m
    u *= inverse
    v *= inverse
    pixels = np.clip(v.astype(np.int32), 0, seen.rows - 1)
    pixels *= np.int32(seen.stride)
    pixels += np.clip(u.astype(np.int32), 0, seen.stride - 1)
    extremes = (base[:, 2].min() + around[:, 2].min(), base[:, 2].max() + around[:, 2].max())
    return pixels, z_m, extremes


def _average(
    arrays: Mapping[str, NDArray[Any]],
    slots: Slots,
    distance: NDArray[np.float32],
    told: NDArray[np.float32],
    rules: IntegrationRules,
) -> None:
    mean, weight = arrays["tsdf"][slots], arrays["weight"][slots]
    weight += told
    share = told / np.maximum(weight, _TINY)
    distance -= mean
    distance *= share
    mean += distance
    np.minimum(weight, np.float32(rules.max_weight), out=weight)
    arrays["tsdf"][slots], arrays["weight"][slots] = mean, weight


def _describe(
    arrays: Mapping[str, NDArray[Any]],
    voxels: NDArray[np.int64],
    pixels: NDArray[np.int32],
    told: NDArray[np.float32],
    seen: PaddedImages,
    closeness: NDArray[np.float32] | None,
) -> None:
    """Take colour and classes into the voxels near the surface, by their flat numbers."""
    if seen.color is not None:
        colors = arrays["color"].reshape(-1, 4).view(_FOUR).reshape(-1)
        mean = colors.take(voxels).view(np.float32).reshape(-1, 4)
        weight = mean[:, 3] + told
        change = seen.color.take(pixels).view(np.uint8).reshape(-1, 4) * np.float32(1 / 255)
        change -= mean
        change *= (told / np.maximum(weight, _TINY))[:, None]
        mean += change
        mean[:, 3] = weight
        colors[voxels] = mean.view(_FOUR).reshape(-1)
    if seen.labels is not None and closeness is not None and "class_id" in arrays:
        class_id = arrays["class_id"].reshape(-1, arrays["class_id"].shape[-1])
        class_weight = arrays["class_weight"].reshape(class_id.shape)
        fuse_classes(class_id, class_weight, voxels, seen.labels.take(pixels), told * closeness)
