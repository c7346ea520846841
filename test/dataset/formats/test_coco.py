"""The COCO format, read back with pycocotools and by the rules of panopticapi."""

from __future__ import annotations

import json
import re
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from object_worlds import object_config
from PIL import Image
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval
from repository import REPOSITORY
from small_datasets import render_dataset
from synthetic_datasets import LEGEND, drawn_arrays, frame_record, write_dataset

from oaisys_core.errors import InvalidInputError
from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.formats.base import ExportOptions
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


def test_every_object_in_view_has_its_mask_class_box_and_area(
    rendered: Dataset, exported: Path
) -> None:
    assert sum(masks_of(rendered, exported, split) for split in ("train", "val")) > 5


def masks_of(rendered: Dataset, exported: Path, split: str) -> int:
    """Check all annotations of a split, and return their number."""
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
    return masks


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
    (path,) = (tmp_path / "out/panoptic/panoptic_train").iterdir()
    assert np.array_equal(panoptic_ids(path) == VOID, arrays["instance"] > 0)


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("known")
    render_dataset(folder / "set", {0: "train", 1: "val"}, 3, object_config(folder))
    return open_dataset(folder / "set")


def mask_by_documented_lines(annotation: dict[str, Any], image: dict[str, Any]) -> Any:
    """Return what the lines in docs/dataset.md make of an annotation, as torchvision does."""
    text = (REPOSITORY / "docs/dataset.md").read_text(encoding="utf-8")
    (lines,) = re.findall(r"```python\n(from pycocotools import mask.*?)```", text, re.DOTALL)
    names = {"annotation": annotation, "height": image["height"], "width": image["width"]}
    exec(lines, names)
    return names["mask"]


def test_polygons_are_the_masks_and_crowds_stay_run_lengths(known: Dataset, tmp_path: Path) -> None:
    options = ExportOptions(settings={"segmentation": "polygons"})
    export_dataset(known, "coco", tmp_path / "out", options)
    coco = opened(tmp_path / "out", "train")
    for image, sample in zip(coco.imgs.values(), known.split("train"), strict=True):
        annotations = coco.loadAnns(coco.getAnnIds(image["id"]))
        assert annotations
        for annotation in annotations:
            # torchvision's reference and ultralytics take lists of polygons alone.
            assert isinstance(annotation["segmentation"], list)
            assert all(len(ring) >= 6 for ring in annotation["segmentation"])
            mask = sample.arrays["instance"] == annotation["instance_id"]
            assert np.array_equal(coco.annToMask(annotation), mask)
            assert np.array_equal(mask_by_documented_lines(annotation, image), mask)
            assert annotation["area"] == mask.sum()
    write_dataset(tmp_path / "set", {0: "train"})
    export_dataset(open_dataset(tmp_path / "set"), "coco", tmp_path / "crowds", options)
    crowded = opened(tmp_path / "crowds", "train")
    kinds = {(a["iscrowd"], type(a["segmentation"])) for a in crowded.anns.values()}
    assert kinds == {(0, list), (1, dict)}


def test_small_and_hidden_objects_are_left_out_void_and_counted(
    known: Dataset, tmp_path: Path
) -> None:
    options = ExportOptions(settings={"min_area": "60", "min_visible": "0.9"})
    counts = export_dataset(known, "coco", tmp_path / "out", options)
    small = hidden = 0
    for split in ("train", "val"):
        coco = opened(tmp_path / "out", split)
        for image, sample in zip(coco.imgs.values(), known.split(split), strict=True):
            rows = known.objects(sample.record)
            chosen = {
                row.instance_id: row
                for row in rows
                if row.visible_px >= 60 and row.visible_share >= 0.9
            }
            small += sum(row.visible_px < 60 for row in rows)
            hidden += sum(row.visible_px >= 60 and row.visible_share < 0.9 for row in rows)
            annotations = coco.loadAnns(coco.getAnnIds(image["id"]))
            assert {each["instance_id"] for each in annotations} == set(chosen)
            path = tmp_path / f"out/panoptic/panoptic_{split}" / image["file_name"]
            ids, instance = panoptic_ids(path), sample.arrays["instance"]
            for row in rows:
                assert (ids[instance == row.instance_id] > 0).all() == (row.instance_id in chosen)
    assert hidden
    assert counts["objects below min_area, left out"] == small
    assert counts["objects below min_visible, left out"] == hidden
    assert f"left out | {hidden} |" in (tmp_path / "out/README.md").read_text()
    bad = ExportOptions(settings={"min_area": "small"})
    with pytest.raises(InvalidInputError, match=r"settings\.min_area"):
        export_dataset(known, "coco", tmp_path / "bad", bad)


def test_every_file_in_annotations_has_instances(exported: Path) -> None:
    # ultralytics' convert_coco takes each JSON file there for one, and asks for these keys.
    for path in (exported / "annotations").glob("*.json"):
        data = json.loads(path.read_text())
        images = {f"{image['id']:d}": image for image in data["images"]}
        for annotation in data["annotations"]:
            assert {"iscrowd", "bbox", "category_id", "segmentation"} <= set(annotation)
            assert str(annotation["image_id"]) in images
    assert [path.name for path in sorted(exported.glob("annotations/*"))] == [
        "instances_train.json",
        "instances_val.json",
    ]


def panoptic_ids(path: Path) -> NDArray[np.int64]:
    colors = np.asarray(Image.open(path)).astype(np.int64)
    return colors[..., 0] + 256 * colors[..., 1] + 65536 * colors[..., 2]


@pytest.mark.parametrize("split", ["train", "val"])
def test_panoptic_images_obey_the_rules_of_panopticapi(exported: Path, split: str) -> None:
    folder = exported / "panoptic"
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
    folder = exported / "panoptic"
    panoptic = json.loads((folder / "panoptic_val.json").read_text())
    for annotation, sample in zip(panoptic["annotations"], rendered.split("val"), strict=True):
        ids = panoptic_ids(folder / "panoptic_val" / annotation["file_name"])
        labels = np.zeros_like(ids)
        for segment in annotation["segments_info"]:
            labels[ids == segment["id"]] = segment["category_id"]
        assert np.array_equal(labels, sample.arrays["semantic_0"])
