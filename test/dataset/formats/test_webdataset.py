"""The WebDataset format, read back with webdataset, Hugging Face's datasets and pyarrow."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
import webdataset
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_dataset import Dataset
from oaisys_dataset.formats.base import ExportOptions
from oaisys_dataset.formats.export import export_dataset
from oaisys_dataset.shards import pixels_sha256

SHARD_BYTES = 40_000
"""Small enough for several tar files."""


@pytest.fixture(scope="module")
def exported(rendered: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("webdataset") / "out"
    counts = export_dataset(
        rendered, "webdataset", target, ExportOptions({"shard_bytes": str(SHARD_BYTES)})
    )
    assert counts["frames"] == len(rendered)
    return target


def test_webdataset_reads_every_frame_in_order(rendered: Dataset, exported: Path) -> None:
    for split in rendered.splits:
        tars = sorted(map(str, exported.glob(f"{split}-*.tar")))
        found = list(webdataset.WebDataset(tars, shardshuffle=False).decode("rgb8"))
        for frame, sample in zip(found, rendered.split(split), strict=True):
            assert frame["__key__"] == sample.record.frame_id
            assert np.array_equal(frame["rgb.png"], sample.arrays["rgb"])
            for modality in ("depth", "semantic_0", "instance", "normal"):
                image = frame[f"{modality}.npz"]["data"]
                assert image.dtype == sample.arrays[modality].dtype
                assert np.array_equal(image, sample.arrays[modality])
            assert np.array_equal(frame["json"]["K"], sample.K)
            assert np.array_equal(frame["json"]["T_map_camera"], sample.T_map_camera)


def test_tar_files_keep_within_their_size(exported: Path) -> None:
    tars = list(exported.glob("*.tar"))
    assert len(tars) > 2
    assert all(tar.stat().st_size <= SHARD_BYTES for tar in tars)


def test_a_frame_that_is_larger_than_a_tar_file_is_refused(
    rendered: Dataset, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInputError, match=r"shard_bytes.*000000_0000_camera needs"):
        export_dataset(
            rendered, "webdataset", tmp_path / "out", ExportOptions({"shard_bytes": "15000"})
        )
    assert not list(tmp_path.iterdir())


def test_the_index_gives_direct_access_to_each_image(rendered: Dataset, exported: Path) -> None:
    rows = pyarrow.parquet.read_table(exported / "index.parquet").to_pylist()
    assert len(rows) == len(rendered)
    for row, sample in zip(rows, rendered, strict=True):
        assert row["frame_id"] == sample.record.frame_id
        assert (row["world"], row["split"]) == (sample.record.world, sample.record.split)
        assert np.array_equal(row["K"], sample.K)
        image = member(exported / row["tar"], row["offset_depth"], row["size_depth"])
        assert np.array_equal(image, sample.arrays["depth"])
        assert row["pixels_sha256_depth"] == pixels_sha256(image)


def member(tar: Path, offset: int, size: int) -> NDArray[np.float32]:
    with tar.open("rb") as file:
        file.seek(offset)
        data = file.read(size)
    return np.asarray(np.load(io.BytesIO(data))["data"])


def test_legends_are_beside_the_tar_files(rendered: Dataset, exported: Path) -> None:
    (legend,) = json.loads((exported / "legend_val.json").read_text())
    assert legend["world"] == 2
    assert {int(i): name for i, name in legend["labels"].items()} == rendered.legend(2).labels


@pytest.mark.long
def test_hugging_face_streams_it(
    rendered: Dataset, exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    import datasets

    files = {split: str(exported / f"{split}-*.tar") for split in rendered.splits}
    for split in rendered.splits:
        found = datasets.load_dataset(
            "webdataset", data_files=files, split=split, streaming=True, cache_dir=str(tmp_path)
        )
        for frame, sample in zip(found, rendered.split(split), strict=True):
            assert frame["__key__"] == sample.record.frame_id
            assert np.array_equal(np.asarray(frame["rgb.png"]), sample.arrays["rgb"])
            depth_m = np.asarray(frame["depth.npz"]["data"], np.float32)
            assert np.array_equal(depth_m, sample.arrays["depth"])
            assert frame["json"]["K"] == sample.K.tolist()
