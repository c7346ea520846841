"""What is written to a shard is read back, from every kind of place."""

from __future__ import annotations

import tarfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from synthetic_datasets import CAMERA, LEGEND, drawn_arrays, frame_record, write_dataset

from oaisys_core.errors import InvalidInputError, NotFoundError, RenderError
from oaisys_dataset import open_dataset
from oaisys_dataset.manifest import FrameRecord, WorldFailure
from oaisys_dataset.places import open_place
from oaisys_dataset.shards import whole_worlds, write_failure, writing_shard

WORLDS = {0: "train", 2: "val", 13: "train"}


@pytest.fixture(params=["folder", "file", "memory"])
def where(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    kinds = {"folder": str(tmp_path), "file": f"file://{tmp_path}"}
    return kinds.get(request.param, f"memory://{tmp_path.name}")


def test_samples_come_back_bit_for_bit_by_index_and_streamed(where: str) -> None:
    written = write_dataset(where, WORLDS)
    dataset = open_dataset(where)
    assert len(dataset) == len(dataset.records) == 9
    assert (dataset.worlds, dataset.splits) == ((0, 2, 13), ("train", "val"))
    for index, sample in enumerate(dataset.stream()):
        again = dataset[index]
        assert again.record == sample.record
        assert list(sample.arrays) == sorted(written[sample.record.frame_id])
        for modality, pixels in written[sample.record.frame_id].items():
            assert np.array_equal(sample.arrays[modality], pixels, equal_nan=True)
            assert np.array_equal(again.arrays[modality], pixels, equal_nan=True)
            assert sample.arrays[modality].dtype == sample.record.images[modality].dtype
        assert sample.arrays["instance"].dtype == np.int32
        assert np.array_equal(sample.K, CAMERA.K)
        assert sample.T_map_camera[0, 3] == sample.record.world


def test_a_frame_is_found_by_its_id_and_a_split_has_its_worlds_only(tmp_path: Path) -> None:
    write_dataset(tmp_path, WORLDS)
    dataset = open_dataset(tmp_path)
    assert dataset.record("000013_0002_camera").view == 2
    assert dataset[-1].record == dataset.record("000013_0002_camera")
    assert [sample.record.view for sample in dataset[1:3]] == [1, 2]
    train = dataset.split("train")
    assert train.worlds == (0, 13)
    assert {record.split for record in train.records} == {"train"}
    assert train.legend(13).labels == {1: "rock", 2: "sand", 3: "of world 13"}
    assert train.legend(0).instances[70000].semantic_id == 1
    for name in ("000013_0003_camera", "000001_0000_camera", "camera", f"{'9' * 5000}_0000_camera"):
        with pytest.raises(NotFoundError, match=name[:60]):
            dataset.record(name)
    with pytest.raises(NotFoundError, match="only train, val"):
        dataset.split("test")
    with pytest.raises(IndexError):
        dataset[9]


def test_other_programs_read_a_shard(tmp_path: Path) -> None:
    written = write_dataset(tmp_path, {4: "train"})
    with tarfile.open(tmp_path / "shards/world_000004.tar") as tar:
        names = tar.getnames()
        file = tar.extractfile("000004_0001_camera.rgb.png")
        assert file is not None
        rgb = cv2.imdecode(np.frombuffer(file.read(), np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert np.array_equal(rgb, written["000004_0001_camera"]["rgb"])
    assert names[-1] == "legend.json"
    assert len(names) == 3 * 5 + 1


def test_equal_worlds_are_equal_files(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_dataset(tmp_path / name, WORLDS)
    files = {path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.*")}
    assert len(files) == 7
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_a_world_that_was_interrupted_leaves_nothing_behind(where: str) -> None:
    write_dataset(where, WORLDS)
    place = open_place(where)
    wrong = {"rgb": np.zeros((2, 2), np.uint8)}
    with pytest.raises(InvalidInputError, match="rgb"), writing_shard(place, 14) as shard:
        shard.add(frame_record(14, 0, "train"), wrong)
    with pytest.raises(RenderError, match="legend"), writing_shard(place, 15) as shard:
        shard.add(frame_record(15, 0, "train"), drawn_arrays(np.random.default_rng(0)))
    assert whole_worlds(place) == [0, 2, 13]
    assert len(place.names("shards")) == 6
    assert open_dataset(where).worlds == (0, 2, 13)


def test_failures_are_read_back(where: str) -> None:
    write_dataset(where, {0: "train"})
    failure = WorldFailure(1, "val", 101, "no free view", attempts=3)
    write_failure(open_place(where), failure)
    assert open_dataset(where).failures == (failure,)


def test_a_place_without_a_data_set_is_refused(where: str) -> None:
    with pytest.raises(InvalidInputError, match=r"dataset\.json"):
        open_dataset(where)


def test_a_line_that_is_no_record_is_refused_with_its_place(tmp_path: Path) -> None:
    write_dataset(tmp_path, {0: "train"})
    path = tmp_path / "shards/world_000000.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text(lines[0] + '{"frame_id": 1}\n' + lines[2], encoding="utf-8")
    dataset = open_dataset(tmp_path)
    assert dataset.records[2].view == 2
    with pytest.raises(InvalidInputError, match=r"world_000000\.jsonl:2"):
        dataset.records[1]


def test_records_come_back_from_json(tmp_path: Path) -> None:
    write_dataset(tmp_path, {0: "train"})
    record = open_dataset(tmp_path).records[0]
    assert FrameRecord.from_json(record.to_json()) == record
    outline = record.outline()
    assert (outline.batch_id, outline.sample_id) == (1, 1)
    assert outline.provenance.batch_seed == 100
    assert [frame.modality for frame in outline.frames] == sorted(record.images)


def test_wrong_pixels_are_refused(tmp_path: Path) -> None:
    with writing_shard(open_place(tmp_path), 0) as shard:
        for arrays in {"depth": np.zeros((12, 16))}, {"rgb": np.zeros((12, 16), np.uint8)}:
            with pytest.raises(InvalidInputError, match=next(iter(arrays))):
                shard.add(frame_record(0, 0, "train"), arrays)
        shard.add(frame_record(0, 0, "train"), drawn_arrays(np.random.default_rng(0)))
        shard.finish(LEGEND)
