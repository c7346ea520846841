"""Segments of images, compared with pycocotools."""

from __future__ import annotations

import numpy as np
import pytest
from pycocotools import mask as coco_mask

from oaisys_dataset.formats.segments import number_segments, segments_of


@pytest.mark.parametrize("shape", [(1, 1), (5, 1), (1, 7), (16, 23)])
def test_runs_boxes_and_areas_are_those_of_pycocotools(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        instance = rng.integers(0, 4, shape).astype(np.uint32) * rng.integers(1, 1_000_000)
        semantic = rng.integers(0, 3, shape).astype(np.uint16)
        numbers, labels, instances = number_segments(semantic, instance)
        segments = list(segments_of(numbers, labels, instances))
        assert {s.number for s in segments} == set(np.unique(numbers)) - {0}
        assert np.array_equal(numbers == 0, (instance == 0) & (semantic == 0))
        for segment in segments:
            wanted = numbers == segment.number
            encoded = coco_mask.encode(np.asfortranarray(wanted.astype(np.uint8)))
            runs = {"counts": segment.runs, "size": list(shape)}
            assert coco_mask.frPyObjects(runs, *shape) == encoded
            assert list(segment.bbox_px) == coco_mask.toBbox(encoded).tolist()
            assert segment.area_px == coco_mask.area(encoded) == wanted.sum()


def test_an_object_is_one_segment_with_the_label_of_most_of_its_pixels() -> None:
    instance = np.array([[7, 7, 7, 0, 0], [0, 0, 0, 0, 7]], np.uint32)
    semantic = np.array([[5, 5, 2, 2, 0], [9, 9, 2, 2, 2]], np.uint16)
    numbers, labels, instances = number_segments(semantic, instance)
    assert numbers.tolist() == [[1, 1, 1, 2, 0], [3, 3, 2, 2, 1]]
    # Labels 2 and 5 have two pixels each: the lesser one counts.
    assert labels.tolist() == [2, 2, 9]
    assert instances.tolist() == [7, 0, 0]
