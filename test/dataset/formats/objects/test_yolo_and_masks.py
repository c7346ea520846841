"""YOLO and palette masks, read by the rules of ultralytics, torchvision and mmsegmentation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from PIL import Image
from pycocotools import mask as coco_mask
from synthetic_datasets import write_dataset

from oaisys_core.errors import InvalidInputError
from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.formats.base import ExportOptions
from oaisys_dataset.formats.export import export_dataset
from oaisys_dataset.formats.objects.outlines import join_rings, mask_outlines


def labels_of(image: Path) -> Path:
    """Return the labels of an image, where ultralytics looks for them."""
    before, _, after = str(image).rpartition("/images/")
    return Path(f"{before}/labels/{after}").with_suffix(".txt")


def test_boxes_of_yolo_are_those_of_the_pixels(known: Dataset, tmp_path: Path) -> None:
    export_dataset(known, "yolo", tmp_path / "out")
    data = yaml.safe_load((tmp_path / "out/data.yaml").read_text())
    assert set(data) == {"train", "val", "names"}
    assert data["names"] == {0: "ball", 1: "crate", 2: "wedge"}
    lines = 0
    for split in ("train", "val"):
        images = sorted((tmp_path / "out" / data[split]).iterdir())
        for image, sample in zip(images, known.split(split), strict=True):
            assert np.array_equal(np.asarray(Image.open(image)), sample.arrays["rgb"])
            height, width = sample.arrays["instance"].shape
            wanted = set()
            for row in known.objects(sample.record):
                v, u = np.nonzero(sample.arrays["instance"] == row.instance_id)
                box = (u.min(), v.min(), u.max() + 1, v.max() + 1)
                wanted.add((row.label, *map(int, box)))
            found = set()
            for line in labels_of(image).read_text().splitlines():
                number, *shares = line.split()
                x, y, w, h = (float(each) for each in shares)
                assert 0 <= x <= 1
                start = ((x - w / 2) * width, (y - h / 2) * height)
                end = ((x + w / 2) * width, (y + h / 2) * height)
                found.add((data["names"][int(number)], *(round(v) for v in (*start, *end))))
                lines += 1
            assert found == wanted
    assert lines


def test_segments_of_yolo_fill_to_the_pixels(known: Dataset, tmp_path: Path) -> None:
    export_dataset(known, "yolo", tmp_path / "out", ExportOptions(settings={"labels": "segments"}))
    lines = 0
    for sample in known:
        record, ids = sample.record, sample.arrays["instance"]
        height, width = ids.shape
        text = (tmp_path / f"out/labels/{record.split}/{record.frame_id}.txt").read_text()
        masks = [ids == row.instance_id for row in known.objects(record)]
        for line in text.splitlines():
            points = np.array(line.split()[1:], float).reshape(-1, 2)
            assert len(points) >= 3
            assert points.min() >= 0
            assert points.max() <= 1
            polygon = (points * (width, height)).ravel().tolist()
            filled = coco_mask.decode(
                coco_mask.merge(coco_mask.frPyObjects([polygon], height, width))
            )
            assert any(np.array_equal(filled, mask) for mask in masks)
            lines += 1
    assert lines


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_outlines_of_any_mask_fill_to_it(share: float) -> None:
    rng = np.random.default_rng(7)
    for _ in range(40):
        height, width = (int(n) for n in rng.integers(1, 24, 2))
        mask: NDArray[np.bool_] = rng.random((height, width)) < share
        rings = mask_outlines(mask)
        if not mask.any():
            assert rings == []
            continue
        for each in (rings, [join_rings(rings)]):
            polygons = [ring.ravel().astype(float).tolist() for ring in each]
            encoded = coco_mask.merge(coco_mask.frPyObjects(polygons, height, width))
            assert np.array_equal(coco_mask.decode(encoded), mask)


def test_a_set_without_val_says_what_data_yaml_names(known: Dataset, tmp_path: Path) -> None:
    export_dataset(known.split("train"), "yolo", tmp_path / "out")
    text = (tmp_path / "out/data.yaml").read_text()
    assert "no split val" in text
    assert yaml.safe_load(text)["val"] == "images/train"


def test_an_empty_frame_has_an_empty_label_file(known: Dataset, tmp_path: Path) -> None:
    options = ExportOptions(settings={"min_area": "1e6"})
    counts = export_dataset(known, "yolo", tmp_path / "out", options)
    files = list((tmp_path / "out/labels").rglob("*.txt"))
    assert len(files) == len(known)
    assert {file.read_text() for file in files} == {""}
    assert counts["objects below min_area, left out"] > 0


def test_masks_are_palette_images_that_voc_readers_read(known: Dataset, tmp_path: Path) -> None:
    export_dataset(known, "masks", tmp_path / "out")
    root = tmp_path / "out/VOCdevkit/VOC2012"
    classes = json.loads((tmp_path / "out/classes.json").read_text())
    assert [each["number"] for each in classes] == list(range(len(classes)))
    assert classes[0]["name"] == "unlabelled"
    for split in ("train", "val"):
        names = (root / f"ImageSets/Segmentation/{split}.txt").read_text().split()
        for name, sample in zip(names, known.split(split), strict=True):
            assert name == sample.record.frame_id
            image = Image.open(root / f"JPEGImages/{name}.jpg").convert("RGB")
            off = np.abs(np.asarray(image).astype(int) - sample.arrays["rgb"])
            assert off.mean() < 4
            mask = Image.open(root / f"SegmentationClass/{name}.png")
            assert mask.mode == "P"
            palette = mask.getpalette()
            assert palette is not None
            for each in classes:
                number = each["number"]
                assert palette[3 * number : 3 * number + 3] == each["color"]
            numbers = np.asarray(mask)
            to_label = np.array([each["label_id"] for each in classes])
            assert np.array_equal(to_label[numbers], sample.arrays["semantic_0"])
    assert classes[1]["color"] == [128, 0, 0]


def test_lossless_masks_and_other_levels(known: Dataset, tmp_path: Path) -> None:
    options = ExportOptions(settings={"images": "png"})
    export_dataset(known, "masks", tmp_path / "out", options)
    record = known.records[0]
    image = Image.open(tmp_path / f"out/VOCdevkit/VOC2012/JPEGImages/{record.frame_id}.png")
    assert np.array_equal(np.asarray(image), known[0].arrays["rgb"])
    with pytest.raises(InvalidInputError, match=r"settings\.level"):
        export_dataset(known, "masks", tmp_path / "bad", ExportOptions(settings={"level": "12"}))


def test_min_visible_needs_the_table_of_objects(tmp_path: Path) -> None:
    write_dataset(tmp_path / "set", {0: "train"})
    dataset = open_dataset(tmp_path / "set")
    options = ExportOptions(settings={"min_visible": "0.5"})
    with pytest.raises(InvalidInputError, match=r"settings\.min_visible.*table of objects"):
        export_dataset(dataset, "yolo", tmp_path / "out", options)
    options = ExportOptions(settings={"min_visible": "1.5"})
    with pytest.raises(InvalidInputError, match="from 0 to 1"):
        export_dataset(dataset, "yolo", tmp_path / "out", options)
