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

from oaisys_mapping.blocks import BLOCK_VOXELS, VOXELS, Coordinates, Slots
from oaisys_mapping.observation import Observation
from oaisys_mapping.semantic_fusion import fuse_classes

PART_BLOCKS = 192
"""Blocks that are worked on at a time: an intermediate result has 400 kB."""

FADING_VOXELS = 1.0
"""Depth of the layer before the truncation behind the surface in which an observation counts less
and less (all of what is behind fades in Oleynikova et al., "Voxblox", IROS 2017): what lies far
behind a rim is another view's to say. On a world of the demo's the farthest gap in the overlap
shrinks from 15 to 12 cm so, and the RMSE from 5.2 to 5.0 mm; fading from one voxel behind the
surface on does little more."""

CLOSE_VOXELS = 0.3
"""Distance in front of the surface at which a label counts half."""

THREADS = min(8, os.cpu_count() or 1)

POOL = ThreadPoolExecutor(THREADS, thread_name_prefix="voxels")

VOXEL_BITS = VOXELS.bit_length() - 1

_TINY = np.float32(1e-30)
_FOUR = np.complex128
"""Moves four float32 at a time."""


@dataclass(frozen=True)
class FusionRules:
    """What holds for all views.

    Attributes:
        truncation_m: Distance that counts as 1.
        described_m: Distance in front of the surface up to which colour and classes are kept: only
            voxels beside the surface are asked for them.
        max_weight: Weight beyond which a voxel's does not grow.
    """

    voxel_size_m: float
    truncation_m: float
    described_m: float
    max_weight: float


def voxel_offsets() -> NDArray[np.int64]:
    """Return the (`VOXELS`, 3) places of a block's voxels in it, x first."""
    number = np.arange(VOXELS)
    return np.column_stack(
        (number % BLOCK_VOXELS, number // BLOCK_VOXELS % BLOCK_VOXELS, number // BLOCK_VOXELS**2)
    )


def fuse(
    arrays: Mapping[str, NDArray[Any]],
    coordinates: Coordinates,
    slots: Slots,
    seen: Observation,
    rules: FusionRules,
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
    seen: Observation,
    rules: FusionRules,
    first: int,
) -> NDArray[np.bool_]:
    slots = slots[first : first + PART_BLOCKS]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        pixels, z_m, (least_m, most_m) = _projected(
            coordinates[first : first + PART_BLOCKS], seen, rules
        )
        depth_m = seen.depth_m.take(pixels)
        ahead_m = depth_m - z_m
        is_told = ahead_m > -rules.truncation_m
        if most_m > seen.max_range_m:
            is_told &= (z_m <= seen.max_range_m) | (depth_m < np.inf)
        if least_m <= 0:
            is_told &= z_m > 0
    told = is_told.astype(np.float32)
    _fade(told, is_told, ahead_m, rules)
    if seen.weight is not None:
        told *= seen.weight.take(pixels)
    is_near = ahead_m < rules.described_m
    is_near &= is_told
    near = np.flatnonzero(is_near)
    closeness = None
    if seen.labels is not None:
        closeness = _closeness(ahead_m.take(near) / rules.voxel_size_m)
    distance = np.minimum(ahead_m, np.float32(rules.truncation_m), out=ahead_m)
    distance *= np.float32(1 / rules.truncation_m)
    _average(arrays, slots, distance, told, rules)
    voxels = slots.astype(np.int64).take(near >> VOXEL_BITS) << VOXEL_BITS
    voxels += near & (VOXELS - 1)
    _describe(arrays, voxels, pixels.take(near), told.take(near), seen, closeness)
    return np.asarray(is_told.view(np.uint64).any(axis=1))


def _fade(
    told: NDArray[np.float32],
    is_told: NDArray[np.bool_],
    ahead_m: NDArray[np.float32],
    rules: FusionRules,
) -> None:
    """Let an observation count less in voxels far behind what the ray hit, in place."""
    fading_m = FADING_VOXELS * rules.voxel_size_m
    behind = np.flatnonzero((ahead_m < fading_m - rules.truncation_m) & is_told)
    told.ravel()[behind] = (ahead_m.take(behind) + np.float32(rules.truncation_m)) / fading_m


def _closeness(voxels_ahead: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return what labels count in voxels that lie so far in front of what the ray hit.

    All of it behind the surface, less and less in front: beside a step, rays pass on their way to
    what lies further down, and would outvote the step's own class. The demo's rocks, seen from
    above, come out with an IoU of 0.902 so, and with 0.855 where all counts alike.
    """
    ahead = np.maximum(voxels_ahead, 0)
    return np.asarray(CLOSE_VOXELS**2 / (CLOSE_VOXELS**2 + np.square(ahead)), np.float32)


def _projected(
    coordinates: Coordinates, seen: Observation, rules: FusionRules
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
    rules: FusionRules,
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
    seen: Observation,
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
