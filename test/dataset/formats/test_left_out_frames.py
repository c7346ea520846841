"""Views that lack images, as by ``modality_intervals``: what each export leaves out is told."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from small_datasets import SMALL, render_dataset

from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.formats.base import format_names
from oaisys_dataset.formats.export import export_dataset

VIEWS = 6
WITH_RGB, WITH_DEPTH = {0, 2, 4}, {0, 3}
"""By intervals of 2 and of 3; the other images are always there."""

LEFT_OUT = {
    "bop": ("rgb, depth, instance", VIEWS - len(WITH_RGB & WITH_DEPTH)),
    "coco": ("rgb, semantic_0, instance", VIEWS - len(WITH_RGB)),
    "colmap": ("rgb", VIEWS - len(WITH_RGB)),
    "kitti": ("rgb", VIEWS - len(WITH_RGB)),
    "kitti_object": ("rgb, instance", VIEWS - len(WITH_RGB)),
    "masks": ("rgb, semantic_0", VIEWS - len(WITH_RGB)),
    "nerfstudio": ("rgb", VIEWS - len(WITH_RGB)),
    "yolo": ("rgb, instance", VIEWS - len(WITH_RGB)),
}
MISSING = {
    "colmap": {"depth": len(WITH_RGB - WITH_DEPTH)},
    "kitti": {"depth": len(WITH_RGB - WITH_DEPTH)},
    "nerfstudio": {"depth": len(WITH_RGB - WITH_DEPTH)},
}
MISSING |= {
    name: {"rgb": VIEWS - len(WITH_RGB), "depth": VIEWS - len(WITH_DEPTH)}
    for name in ("euroc", "files", "tum", "webdataset")
}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("intervals") / "set"
    (camera,) = SMALL["sensors"]["cameras"]
    camera = {**camera, "modality_intervals": {"rgb": 2, "depth": 3}}
    sensors: dict[str, Any] = {**SMALL["sensors"], "cameras": [camera]}
    render_dataset(folder, {0: "train"}, VIEWS, {**SMALL, "sensors": sensors})
    return open_dataset(folder)


@pytest.mark.parametrize("name", format_names())
def test_what_each_format_leaves_out_is_counted_and_no_row_of_frames(
    name: str, dataset: Dataset, tmp_path: Path
) -> None:
    counts = export_dataset(dataset, name, tmp_path / "out")
    modalities, left_out = LEFT_OUT.get(name, ("", 0))
    told = {f"frames without {modalities}, left out": left_out} if left_out else {}
    told |= {f"frames whose {each} is missing": n for each, n in MISSING.get(name, {}).items()}
    found = {what: n for what, n in counts.items() if what.startswith(("frames w", "frames wh"))}
    assert found == told
    assert counts["frames"] == VIEWS - left_out
    with (tmp_path / "out/frames.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) == VIEWS - left_out
    readme = (tmp_path / "out/README.md").read_text()
    for number in told.values():
        assert f"| {number} |" in readme
    frames = VIEWS - left_out
    noun = "frame" if frames == 1 else "frames"
    assert f"train: 1 world, {frames} {noun}." in readme
    card = (tmp_path / "out/data_card.html").read_text()
    assert f">{frames} from 1 world<" in card


def test_files_of_kitti_are_those_that_are_told(dataset: Dataset, tmp_path: Path) -> None:
    export_dataset(dataset, "kitti", tmp_path / "out")
    sequence = tmp_path / "out/sequences/00"
    names = [sorted(path.stem for path in (sequence / f"{kind}_2").iterdir())
             for kind in ("image", "depth", "label")]  # fmt: skip
    assert names == [["000000", "000001", "000002"], ["000000"], ["000000", "000001", "000002"]]


def test_rows_of_hdf5_without_an_image_are_named_and_no_depth_of_0(
    dataset: Dataset, tmp_path: Path
) -> None:
    counts = export_dataset(dataset, "hdf5", tmp_path / "out")
    lacking = 2 * VIEWS - len(WITH_RGB) - len(WITH_DEPTH)
    assert counts["images that views lack, NaN or 0 in their rows"] == lacking
    with h5py.File(tmp_path / "out/train/world_000000.h5") as file:
        camera = file["camera"]
        for name, views in (("rgb", WITH_RGB), ("depth", WITH_DEPTH), ("instance", range(VIEWS))):
            missing = set(camera[name].attrs["missing"].tolist())
            assert missing == set(range(VIEWS)) - set(views)
        for view in range(VIEWS):
            assert bool(np.isnan(camera["depth"][view]).all()) == (view not in WITH_DEPTH)


def test_a_data_set_without_depth_lacks_none(tmp_path: Path) -> None:
    (camera,) = SMALL["sensors"]["cameras"]
    sensors = {**SMALL["sensors"], "cameras": [{**camera, "modalities": ["rgb"]}]}
    render_dataset(tmp_path / "set", {0: "train"}, 2, {**SMALL, "sensors": sensors})
    for name in ("kitti", "euroc", "files", "webdataset"):
        counts = export_dataset(open_dataset(tmp_path / "set"), name, tmp_path / name)
        assert not [what for what in counts if "without" in what or "missing" in what]
