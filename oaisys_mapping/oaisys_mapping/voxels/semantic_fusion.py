"""Class votes per voxel, in memory that does not grow with the number of classes.

Every voxel keeps its `CLASSES_KEPT` heaviest classes by the space-saving algorithm (Metwally,
Agrawal and El Abbadi, "Efficient computation of frequent and top-k elements in data streams", ICDT
2005): a class without room replaces the lightest one and inherits its weight. So a class with more
than 1 / `CLASSES_KEPT` of the weight is always kept, and the weights sum up to all votes.
"""

from __future__ import annotations

import colorsys

import numpy as np
from numpy.typing import NDArray

UNLABELLED = 0

_GOLDEN_RATIO = 0.618034


def fuse_classes(
    class_id: NDArray[np.uint16],
    class_weight: NDArray[np.float32],
    voxels: NDArray[np.int64],
    labels: NDArray[np.uint16],
    weights: NDArray[np.float32],
) -> None:
    """Add one vote to each of N different voxels, in place.

    Most voxels hold one class and get a vote for it; only the others need a search.

    Args:
        class_id, class_weight: (M, kept) of all voxels, contiguous.
        voxels: (N,) rows of the voxels.
        labels: (N,) voted classes; 0 (unlabelled) is ignored.
        weights: (N,) weights of the votes, at least 0.
    """
    ids, summed = class_id.reshape(-1), class_weight.reshape(-1)
    first = voxels * class_id.shape[1]
    first_id, first_weight = ids.take(first), summed.take(first)
    is_labelled = labels != UNLABELLED
    is_first = ((first_id == labels) | (first_weight == 0)) & is_labelled
    if is_first.all():
        ids[first], summed[first] = labels, first_weight + weights
        return
    simple, rest = np.flatnonzero(is_first), np.flatnonzero(is_labelled & ~is_first)
    ids[first[simple]], summed[first[simple]] = labels[simple], (first_weight + weights)[simple]
    _fuse_among_all(class_id, class_weight, voxels[rest], labels[rest], weights[rest])


def _fuse_among_all(
    class_id: NDArray[np.uint16],
    class_weight: NDArray[np.float32],
    voxels: NDArray[np.int64],
    labels: NDArray[np.uint16],
    weights: NDArray[np.float32],
) -> None:
    """Add votes to voxels whose first class may be another one."""
    weight = class_weight[voxels]
    is_known = (class_id[voxels] == labels[:, None]) & (weight > 0)
    place = np.where(is_known.any(axis=1), is_known.argmax(axis=1), weight.argmin(axis=1))
    class_id[voxels, place] = labels
    class_weight[voxels, place] += weights


def most_likely(
    class_id: NDArray[np.uint16], class_weight: NDArray[np.float32]
) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
    """Return the (N,) classes with the greatest weight among (N, M) entries, and their shares.

    A class may have several entries. Without any votes it is class 0 with share 0. Of classes with
    equal weights the smaller id wins.
    """
    is_labelled = class_weight > 0
    ids = np.where(is_labelled, class_id, UNLABELLED).max(axis=1, initial=UNLABELLED)
    share = is_labelled.any(axis=1).astype(np.float32)
    mixed = np.flatnonzero((is_labelled & (class_id != ids[:, None])).any(axis=1))
    ids[mixed], share[mixed] = _heaviest(class_id[mixed], class_weight[mixed])
    return ids.astype(np.uint16), share


def _heaviest(
    class_id: NDArray[np.uint16], class_weight: NDArray[np.float32]
) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
    weight = np.zeros_like(class_weight)
    for entry in range(class_id.shape[1]):
        same = class_id == class_id[:, entry, None]
        weight[:, entry] = (class_weight * same).sum(axis=1)
    best = weight.max(axis=1)
    is_best = (weight == best[:, None]) & (best[:, None] > 0)
    ids = np.where(is_best, class_id, np.iinfo(np.uint16).max).min(axis=1)
    return ids.astype(np.uint16), (best / class_weight.sum(axis=1)).astype(np.float32)


def class_color(class_id: int) -> tuple[int, int, int]:
    """Return the RGB colour of a class; unlabelled is grey.

    Hues are a golden section apart, so that neighbouring ids differ clearly.
    """
    if class_id == UNLABELLED:
        return 128, 128, 128
    hue = (class_id * _GOLDEN_RATIO) % 1.0
    saturation = (0.85, 0.55)[class_id // 8 % 2]
    value = (0.95, 0.7)[class_id // 16 % 2]
    red, green, blue = (round(255 * part) for part in colorsys.hsv_to_rgb(hue, saturation, value))
    return red, green, blue


def class_colors(class_ids: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Return the (N, 3) RGB colours of (N,) classes."""
    known, place = np.unique(class_ids, return_inverse=True)
    palette = np.array([class_color(int(one)) for one in known], np.uint8).reshape(-1, 3)
    return np.asarray(palette[place.ravel()])
