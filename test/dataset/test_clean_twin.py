"""A data set with noisy and true depth in each frame: read, checked and exported."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
from small_datasets import SMALL, render_dataset

from oaisys_dataset import open_dataset
from oaisys_dataset.check import check_dataset
from oaisys_dataset.formats.export import export_dataset

FAULTS = {"depth_noise": "gaussian", "depth_sigma_m": 0.1}


def test_both_depths_are_in_one_frame_and_the_true_one_is_judged(tmp_path: Path) -> None:
    (camera,) = SMALL["sensors"]["cameras"]
    camera = {**camera, "modalities": ["rgb", "depth", "depth_true", "range", "range_true"]}
    sensors = {**SMALL["sensors"], "cameras": [camera], "faults": FAULTS}
    render_dataset(tmp_path / "set", {0: "train"}, 2, {**SMALL, "sensors": sensors})
    dataset = open_dataset(tmp_path / "set")
    for sample in dataset:
        hit = np.isfinite(sample.arrays["depth_true"])
        error_m = (sample.arrays["depth"] - sample.arrays["depth_true"])[hit]
        assert 0.08 < error_m.std() < 0.12
        error_m = (sample.arrays["range"] - sample.arrays["range_true"])[hit]
        assert 0.08 < error_m.std() < 0.2
    report = check_dataset(tmp_path / "set", worlds_rebuilt=1)
    assert report.findings == ()
    assert {each.modality for each in report.audited} == {"depth_true"}
    assert report.points > 2 * 300
    export_dataset(dataset, "hdf5", tmp_path / "out")
    with h5py.File(tmp_path / "out/train/world_000000.h5") as file:
        assert file["camera/depth_true"].attrs["unit"] == "m"
        assert np.array_equal(file["camera/depth_true"][0], dataset[0].arrays["depth_true"])
