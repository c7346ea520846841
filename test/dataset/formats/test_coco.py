"""The COCO format, read back with pycocotools and by the rules of panopticapi."""

from __future__ import annotations

import json
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval
from synthetic_datasets import LEGEND, drawn_arrays, frame_record, write_dataset

from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.formats.export import export_dataset
from oaisys_dataset.places import open_place
from oaisys_dataset.shards import writing_shard

VOID = 0


@pytest.fixture(scope="module")
def exported(rendered: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("coco") / "out"
    counts = export_dataset(rendered, "coco", target)
    assert counts["frames"] == len(rendered)
    return target


def opened(exported: Path, split: str) -> COCO:
    with redirect_stdout(StringIO()):
        return COCO(str(exported / f"annotations/instances_{split}.json"))


@pytest.mark.parametrize("split", ["train", "val"])
def test_every_object_in_view_has_its_mask_class_box_and_area(
    rendered: Dataset, exported: Path, split: str
) -> None:
    coco = opened(exported, split)
    part = rendered.split(split)
    assert len(coco.imgs) == len(part)
    masks = 0
    for image, sample in zip(coco.imgs.values(), part, strict=True):
        assert image["file_name"] == f"{sample.record.frame_id}.png"
        colors = np.asarray(Image.open(exported / split / image["file_name"]))
        assert np.array_equal(colors, sample.arrays["rgb"])
        assert (image["width"], image["height"]) == colors.shape[1::-1]
        annotations = coco.loadAnns(coco.getAnnIds(image["id"], iscrowd=False))
        instance = sample.arrays["instance"]
        assert {a["instance_id"] for a in annotations} == set(np.unique(instance)) - {0}
        legend = rendered.legend(sample.record.world)
        for annotation in annotations:
            wanted = instance == annotation["instance_id"]
            assert np.array_equal(coco.annToMask(annotation), wanted)
            assert annotation["area"] == wanted.sum()
            rows, columns = np.nonzero(wanted)
            left, top, width, height = annotation["bbox"]
            assert (left, left + width) == (columns.min(), columns.max() + 1)
            assert (top, top + height) == (rows.min(), rows.max() + 1)
            thing = legend.instances[annotation["instance_id"]]
            assert coco.cats[annotation["category_id"]]["name"] == thing.label
            masks += 1
    assert masks > 5


def test_the_mean_average_precision_of_the_set_against_itself_is_one(exported: Path) -> None:
    truth = opened(exported, "train")
    found = [
        {key: each[key] for key in ("image_id", "category_id", "segmentation")} | {"score": 1.0}
        for each in truth.anns.values()
        if not each["iscrowd"]
    ]
    with redirect_stdout(StringIO()):
        judged = COCOeval(truth, truth.loadRes(found), "segm")
        # By default 100 objects of an image count; more may be in view.
        judged.params.maxDets = [10_000]
        judged.evaluate()
        judged.accumulate()
    precision = judged.eval["precision"]
    of_all_sizes = precision[..., 0, 0]
    assert (of_all_sizes == 1.0).all()


def test_ground_with_the_label_of_objects_is_a_crowd(tmp_path: Path) -> None:
    # In these random images rock is a label of objects and of pixels without an object.
    pixels = write_dataset(tmp_path / "set", {0: "train"})
    dataset = open_dataset(tmp_path / "set")
    counts = export_dataset(dataset, "coco", tmp_path / "out")
    assert counts["crowd annotations"] == 3
    coco = opened(tmp_path / "out", "train")
    for image in coco.imgs.values():
        of_frame = pixels[Path(image["file_name"]).stem]
        (crowd,) = coco.loadAnns(coco.getAnnIds(image["id"], iscrowd=True))
        wanted = (of_frame["semantic_0"] == 1) & (of_frame["instance"] == 0)
        assert np.array_equal(coco.annToMask(crowd), wanted)
        assert coco.cats[crowd["category_id"]]["name"] == "rock"


def test_objects_without_a_label_are_left_out_and_counted(tmp_path: Path) -> None:
    write_dataset(tmp_path / "set", {})
    arrays = drawn_arrays(np.random.default_rng(0))
    arrays["semantic_0"] = np.where(arrays["instance"] > 0, 0, 2).astype(np.uint16)
    with writing_shard(open_place(tmp_path / "set"), 0) as shard:
        shard.add(frame_record(0, 0, "train"), arrays)
        shard.finish(LEGEND)
    counts = export_dataset(open_dataset(tmp_path / "set"), "coco", tmp_path / "out")
    left_out = len(np.unique(arrays["instance"])) - 1
    assert counts["objects without a label, left out"] == left_out
    assert "left out" in (tmp_path / "out/README.md").read_text()
    (path,) = (tmp_path / "out/annotations/panoptic_train").iterdir()
    assert np.array_equal(panoptic_ids(path) == VOID, arrays["instance"] > 0)


def panoptic_ids(path: Path) -> NDArray[np.int64]:
    colors = np.asarray(Image.open(path)).astype(np.int64)
    return colors[..., 0] + 256 * colors[..., 1] + 65536 * colors[..., 2]


@pytest.mark.parametrize("split", ["train", "val"])
def test_panoptic_images_obey_the_rules_of_panopticapi(exported: Path, split: str) -> None:
    folder = exported / "annotations"
    panoptic = json.loads((folder / f"panoptic_{split}.json").read_text())
    categories = {each["id"]: each for each in panoptic["categories"]}
    images = {each["id"]: each for each in panoptic["images"]}
    assert [each["image_id"] for each in panoptic["annotations"]] == list(images)
    kinds = set()
    for annotation in panoptic["annotations"]:
        ids = panoptic_ids(folder / f"panoptic_{split}" / annotation["file_name"])
        image = images[annotation["image_id"]]
        assert ids.shape == (image["height"], image["width"])
        segments = {each["id"]: each for each in annotation["segments_info"]}
        assert len(segments) == len(annotation["segments_info"])
        assert set(np.unique(ids)) - {VOID} == set(segments)
        for number, segment in segments.items():
            rows, columns = np.nonzero(ids == number)
            assert segment["area"] == len(rows)
            left, top = columns.min(), rows.min()
            size = [columns.max() - left + 1, rows.max() - top + 1]
            assert segment["bbox"] == [left, top, *size]
            kinds.add(categories[segment["category_id"]]["isthing"])
        # Of a stuff category an image has one segment.
        stuff = [s["category_id"] for s in segments.values() if not s["instance_id"]]
        assert len(stuff) == len(set(stuff))
    assert kinds == {0, 1}


def test_panoptic_categories_are_the_semantic_labels(rendered: Dataset, exported: Path) -> None:
    folder = exported / "annotations"
    panoptic = json.loads((folder / "panoptic_val.json").read_text())
    for annotation, sample in zip(panoptic["annotations"], rendered.split("val"), strict=True):
        ids = panoptic_ids(folder / "panoptic_val" / annotation["file_name"])
        labels = np.zeros_like(ids)
        for segment in annotation["segments_info"]:
            labels[ids == segment["id"]] = segment["category_id"]
        assert np.array_equal(labels, sample.arrays["semantic_0"])
