"""Integrates a view into voxels: weighted means of projective distance, colour and classes.

As in Curless and Levoy, SIGGRAPH 1996, with weights, free-space clearing by rays that hit nothing,
and classes, which Open3D's integration lacks. Blocks are processed in batches that fit into the
processor's cache; no two batches share a voxel, so the result does not depend on the number of
threads.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_mapping.voxels.block_layout import (
    BLOCK_VOXELS,
    VOXELS,
    BlockCoordinates,
    Slots,
    voxel_offsets,
)
from oaisys_mapping.voxels.config import TsdfConfig
from oaisys_mapping.voxels.padded_images import PaddedImages
from oaisys_mapping.voxels.semantic_fusion import fuse_classes

BATCH_BLOCKS = 192
"""Blocks that are processed at a time: an intermediate array has 400 kB."""

FULL_WEIGHT_DEPTH, HIDDEN_DEPTH = 1 / 3, 1 / 2
"""Depths behind the surface, in truncations, up to which a measurement has its full weight, and
beyond which it has only `HIDDEN_WEIGHT`. Between them the weight falls linearly, as in Oleynikova
et al., "Voxblox", IROS 2017: otherwise views of a rock's top outvote those of its foot."""

HIDDEN_WEIGHT = 1e-3
"""Weight of a measurement in voxels hidden behind the surface. They count as solid until a view
shows otherwise, so that a face seen at grazing angles has two sides, as in the hole filling of
Curless and Levoy, but only close behind a surface."""

FREE_WEIGHT = 1 / 3
"""Weight of a measurement a truncation and more in front of the surface. Beside an edge, rays pass
on their way to what lies far behind; at full weight they would outvote the rays that meet the edge.
A single free ray still clears."""

LABEL_FALLOFF_VOXELS = 0.3
"""Distance in front of the surface at which a label's weight is halved."""

THREADS = min(8, os.cpu_count() or 1)

POOL = ThreadPoolExecutor(THREADS, thread_name_prefix="voxels")

VOXEL_BITS = VOXELS.bit_length() - 1

_TINY = np.float32(1e-30)
_FOUR_FLOATS = np.complex128
"""Moves four float32 at a time."""


def integrate_view(
    arrays: Mapping[str, NDArray[Any]],
    blocks: BlockCoordinates,
    slots: Slots,
    images: PaddedImages,
    config: TsdfConfig,
) -> NDArray[np.bool_]:
    """Integrate a view into (N, 3) blocks; return (N,) which of them were updated."""
    work = partial(_integrate_batch, arrays, blocks, slots, images, config)
    updated = list(POOL.map(work, range(0, len(slots), BATCH_BLOCKS)))
    return np.concatenate(updated) if updated else np.zeros(0, bool)


def _integrate_batch(
    arrays: Mapping[str, NDArray[Any]],
    blocks: BlockCoordinates,
    slots: Slots,
    images: PaddedImages,
    config: TsdfConfig,
    first: int,
) -> NDArray[np.bool_]:
    slots = slots[first : first + BATCH_BLOCKS]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        pixels, z_m, (least_m, most_m) = _project(
            blocks[first : first + BATCH_BLOCKS], images, config.voxel_size_m
        )
        depth_m = images.depth_m.take(pixels)
        sdf_m = depth_m - z_m
        is_updated = sdf_m > -config.solid_m
        if most_m > images.max_range_m:
            is_updated &= (z_m <= images.max_range_m) | (depth_m < np.inf)
        if least_m <= 0:
            is_updated &= z_m > 0
    tsdf = sdf_m * np.float32(1 / config.truncation_m)
    weight = _weights(tsdf, is_updated)
    np.clip(tsdf, -1, 1, out=tsdf)
    if images.weight is not None:
        weight *= images.weight.take(pixels)
    has_appearance = sdf_m < config.appearance_m
    has_appearance &= sdf_m > -config.truncation_m
    has_appearance &= is_updated
    chosen = np.flatnonzero(has_appearance)
    label_share = None
    if images.labels is not None:
        label_share = _label_shares(sdf_m.take(chosen) / config.voxel_size_m)
    _update_distances(arrays, slots, tsdf, weight, config.max_weight)
    voxels = slots.astype(np.int64).take(chosen >> VOXEL_BITS) << VOXEL_BITS
    voxels += chosen & (VOXELS - 1)
    _update_appearance(
        arrays, voxels, pixels.take(chosen), weight.take(chosen), images, label_share
    )
    return np.asarray(is_updated.view(np.uint64).any(axis=1))


def _weights(tsdf: NDArray[np.float32], is_updated: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the weight of a measurement at signed distances in truncations."""
    behind = tsdf * np.float32(1 / (HIDDEN_DEPTH - FULL_WEIGHT_DEPTH))
    behind += np.float32(HIDDEN_DEPTH / (HIDDEN_DEPTH - FULL_WEIGHT_DEPTH))
    np.maximum(behind, np.float32(HIDDEN_WEIGHT), out=behind)
    slope = (1 - FREE_WEIGHT) / (1 - FULL_WEIGHT_DEPTH)
    ahead = tsdf * np.float32(-slope)
    ahead += np.float32(1 + slope * FULL_WEIGHT_DEPTH)
    np.clip(ahead, np.float32(FREE_WEIGHT), 1, out=ahead)
    weight = np.minimum(behind, ahead, out=behind)
    weight *= is_updated
    return weight


def _label_shares(voxels_ahead: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the share of its weight that a label has so many voxels in front of the surface.

    Behind the surface it is 1. In front it falls: beside a step, rays pass on their way to what
    lies further down, and would outvote the step's own class.
    """
    ahead = np.maximum(voxels_ahead, 0)
    falloff = LABEL_FALLOFF_VOXELS**2
    return np.asarray(falloff / (falloff + np.square(ahead)), np.float32)


def _project(
    blocks: BlockCoordinates, images: PaddedImages, voxel_size_m: float
) -> tuple[NDArray[np.int32], NDArray[np.float32], tuple[float, float]]:
    """Return (N, `VOXELS`) flat pixels and depths of all voxels, and the depths' extremes."""
    matrix, offset = images.pixel_from_map
    base = (voxel_size_m * BLOCK_VOXELS * blocks) @ matrix.T + offset
    around = ((voxel_size_m * voxel_offsets()) @ matrix.T).astype(np.float32)
    u, v, z_m = (base[:, i, None].astype(np.float32) + around[None, :, i] for i in range(3))
    inverse = np.float32(1) / z_m
    u *= inverse
    v *= inverse
    pixels = np.clip(v.astype(np.int32), 0, images.rows - 1)
    pixels *= np.int32(images.row_px)
    pixels += np.clip(u.astype(np.int32), 0, images.row_px - 1)
    extremes = (base[:, 2].min() + around[:, 2].min(), base[:, 2].max() + around[:, 2].max())
    return pixels, z_m, extremes


def _update_distances(
    arrays: Mapping[str, NDArray[Any]],
    slots: Slots,
    tsdf: NDArray[np.float32],
    added: NDArray[np.float32],
    max_weight: float,
) -> None:
    mean, weight = arrays["tsdf"][slots], arrays["weight"][slots]
    weight += added
    share = added / np.maximum(weight, _TINY)
    tsdf -= mean
    tsdf *= share
    mean += tsdf
    np.minimum(weight, np.float32(max_weight), out=weight)
    arrays["tsdf"][slots], arrays["weight"][slots] = mean, weight


def _update_appearance(
    arrays: Mapping[str, NDArray[Any]],
    voxels: NDArray[np.int64],
    pixels: NDArray[np.int32],
    added: NDArray[np.float32],
    images: PaddedImages,
    label_share: NDArray[np.float32] | None,
) -> None:
    """Update colour and classes of voxels near the surface, given by their flat numbers."""
    if images.color is not None:
        colors = arrays["color"].reshape(-1, 4).view(_FOUR_FLOATS).reshape(-1)
        mean = colors.take(voxels).view(np.float32).reshape(-1, 4)
        weight = mean[:, 3] + added
        change = images.color.take(pixels).view(np.uint8).reshape(-1, 4) * np.float32(1 / 255)
        change -= mean
        change *= (added / np.maximum(weight, _TINY))[:, None]
        mean += change
        mean[:, 3] = weight
        colors[voxels] = mean.view(_FOUR_FLOATS).reshape(-1)
    if images.labels is not None and label_share is not None and "class_id" in arrays:
        class_id = arrays["class_id"].reshape(-1, arrays["class_id"].shape[-1])
        class_weight = arrays["class_weight"].reshape(class_id.shape)
        labels = images.labels.take(pixels)
        fuse_classes(class_id, class_weight, voxels, labels, added * label_share)
