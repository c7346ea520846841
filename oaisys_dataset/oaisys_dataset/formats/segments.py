"""Segments of an image: connected or not, the pixels of one object or of one label."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class PixelSegment:
    """Pixels of an image that belong together.

    Attributes:
        number: Its number in the image, from 1.
        label_id: The label of most of its pixels.
        instance_id: Id of the object, 0 for pixels of no object.
        area_px: Number of its pixels.
        bbox_px: Left column, top row, width and height.
        runs: Lengths of the runs of other pixels and of its pixels in turn, column by column, which
            is COCO's uncompressed run-length encoding.
    """

    number: int
    label_id: int
    instance_id: int
    area_px: int
    bbox_px: tuple[int, int, int, int]
    runs: list[int]


def number_segments(
    semantic: NDArray[Any], instance: NDArray[Any]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return (H, W) segment numbers, and the label and instance id of each segment from number 1.

    An object is one segment, with the label of most of its pixels; the pixels of no object are one
    segment for each label. Pixels of no object without a label (0) are in no segment: number 0.
    """
    instance, semantic = instance.astype(np.int64), semantic.astype(np.int64)
    # Objects first, then labels without objects; both in the order of their ids.
    keys = np.where(instance > 0, instance, semantic + (1 << 33))
    keys[(instance == 0) & (semantic == 0)] = 0
    found, numbers = np.unique(np.append(keys.ravel(), 0), return_inverse=True)
    numbers = numbers[:-1].reshape(keys.shape).astype(np.int64)
    objects = np.where(found < 1 << 33, found, 0)[1:]
    return numbers, _majority(numbers, semantic, len(found) - 1), objects


def segments_of(
    numbers: NDArray[np.int64], labels: NDArray[np.int64], instances: NDArray[np.int64]
) -> Iterator[PixelSegment]:
    """Yield the segments of an image that `number_segments` has numbered."""
    height = numbers.shape[0]
    flat = numbers.ravel(order="F")
    starts = np.flatnonzero(np.diff(flat, prepend=-1))
    lengths = np.diff(starts, append=flat.size)
    order = np.argsort(flat[starts], kind="stable")
    firsts = np.searchsorted(flat[starts][order], np.arange(len(labels) + 2))
    for index, (label_id, instance_id) in enumerate(zip(labels, instances, strict=True)):
        mine = order[firsts[index + 1] : firsts[index + 2]]
        begins, sizes = starts[mine], lengths[mine]
        yield PixelSegment(
            number=index + 1,
            label_id=int(label_id),
            instance_id=int(instance_id),
            area_px=int(sizes.sum()),
            bbox_px=_bounding_box(begins, sizes, height),
            runs=_runs(begins, sizes, flat.size),
        )


def _majority(
    numbers: NDArray[np.int64], labels: NDArray[np.int64], count: int
) -> NDArray[np.int64]:
    """Return the most frequent label of each segment from number 1; of equals the least."""
    pairs, pixels = np.unique((numbers << 16 | labels).ravel(), return_counts=True)
    owners, found = pairs >> 16, pairs & 0xFFFF
    order = np.lexsort((found, -pixels, owners))
    firsts = order[np.searchsorted(owners[order], np.arange(1, count + 1))]
    return np.asarray(found[firsts])


def _bounding_box(
    begins: NDArray[np.int64], sizes: NDArray[np.int64], height: int
) -> tuple[int, int, int, int]:
    lasts = begins + sizes - 1
    left, right = int(begins[0] // height), int(lasts[-1] // height)
    # A run that goes on in the next column touches the bottom and the top.
    wraps = begins // height != lasts // height
    top = 0 if wraps.any() else int((begins % height).min())
    bottom = height - 1 if wraps.any() else int((lasts % height).max())
    return left, top, right - left + 1, bottom - top + 1


def _runs(begins: NDArray[np.int64], sizes: NDArray[np.int64], pixels: int) -> list[int]:
    ends = begins + sizes
    gaps = begins - np.concatenate(([0], ends[:-1]))
    runs: list[int] = np.column_stack((gaps, sizes)).ravel().tolist()
    rest = pixels - int(ends[-1])
    return [*runs, rest] if rest else runs
