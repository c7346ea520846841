"""The HDF5 format, read back with h5py."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

import h5py
import numpy as np
import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_dataset import Dataset
from oaisys_dataset.formats.base import ExportOptions
from oaisys_dataset.formats.export import export_dataset


def test_h5py_reads_images_poses_cameras_and_legends(rendered: Dataset, tmp_path: Path) -> None:
    counts = export_dataset(rendered, "hdf5", tmp_path / "out")
    assert counts == {"worlds": 3, "frames": len(rendered)}
    for world, samples in groupby(rendered, key=lambda sample: sample.record.world):
        split = rendered.record(f"{world:06d}_0000_camera").split
        with h5py.File(tmp_path / f"out/{split}/world_{world:06d}.h5") as file:
            camera = file["camera"]
            assert (file.attrs["world"], file.attrs["split"]) == (world, split)
            for row, sample in enumerate(samples):
                for name, image in sample.arrays.items():
                    assert camera[name].dtype == image.dtype
                    assert np.array_equal(camera[name][row], image)
                assert np.array_equal(camera["K"][row], sample.K)
                assert np.array_equal(camera["T_map_camera"][row], sample.T_map_camera)
                assert camera["frame_id"].asstr()[row] == sample.record.frame_id
                assert camera["stamp_s"][row] == sample.record.stamp_s
                assert file.attrs["world_seed"] == sample.record.world_seed
            assert camera["depth"].attrs["unit"] == "m"
            assert np.isinf(camera["depth"][...]).any()
            assert camera["depth"].chunks == (1, 48, 64)
            assert camera["depth"].compression == "gzip"
            legend = rendered.legend(world)
            labels = {int(i): name.decode() for i, name in file["legend/labels"][...]}
            assert labels == legend.labels
            things = {int(row[0]): row for row in file["legend/instances"][...]}
            assert set(things) == set(legend.instances)
            for number, thing in legend.instances.items():
                assert things[number]["name"].decode() == thing.name
                assert things[number]["semantic_id"] == thing.semantic_id


def test_settings_are_checked_and_used(rendered: Dataset, tmp_path: Path) -> None:
    val = rendered.split("val")
    with pytest.raises(InvalidInputError, match=r"settings\.compression.*0 to 9"):
        export_dataset(val, "hdf5", tmp_path / "a", ExportOptions({"compression": "10"}))
    with pytest.raises(InvalidInputError, match="did you mean compression"):
        export_dataset(val, "hdf5", tmp_path / "a", ExportOptions({"compresion": "1"}))
    assert not (tmp_path / "a").exists()
    export_dataset(val, "hdf5", tmp_path / "a", ExportOptions({"compression": "9"}))
    with h5py.File(tmp_path / "a/val/world_000002.h5") as file:
        assert file["camera/depth"].compression_opts == 9
