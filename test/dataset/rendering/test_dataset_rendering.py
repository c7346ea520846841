"""How a data set is begun and continued, and what is counted."""

import re
from dataclasses import replace
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import pytest
from synthetic_datasets import write_dataset

from oaisys_core.config import SimulationConfig
from oaisys_core.errors import InvalidInputError, NotReadyError
from oaisys_dataset.manifest import DatasetInfo, WorldFailure
from oaisys_dataset.places import open_place
from oaisys_dataset.reader import open_dataset
from oaisys_dataset.rendering.dataset_rendering import (
    DatasetRendering,
    DatasetSummary,
    dataset_info,
    first_difference,
)
from oaisys_dataset.rendering.engine import WorldFinished
from oaisys_dataset.rendering.workers import ViewCounts
from oaisys_dataset.shards import HEAD

CONFIG = SimulationConfig(backend="analytic")
INFO = dataset_info(CONFIG, 4, 3, {"train": 0.5, "val": 0.5})


def rendering(out: Path, info: DatasetInfo = INFO) -> DatasetRendering:
    return DatasetRendering(open_place(out), CONFIG, info)


def begin(out: Path, info: DatasetInfo = INFO, *, is_resumed: bool = False) -> DatasetRendering:
    begun = rendering(out, info)
    with begun.begin(is_resumed=is_resumed):
        return begun


def test_a_data_set_is_not_begun_twice_unless_it_is_resumed(tmp_path: Path) -> None:
    assert [task.index for task in begin(tmp_path).left] == [0, 1, 2, 3]
    with pytest.raises(InvalidInputError, match="--resume"):
        begin(tmp_path)
    begin(tmp_path, is_resumed=True)


def test_a_resumed_command_that_never_began_begins(tmp_path: Path) -> None:
    begin(tmp_path, is_resumed=True)
    assert open_dataset(tmp_path).info == INFO


@pytest.mark.parametrize(
    "changed",
    [{"config_sha256": "0"}, {"seed": 2}, {"views": 4}, {"splits": {"all": 1.0}}, {"worlds": 3}],
)
def test_another_data_set_is_not_continued(tmp_path: Path, changed) -> None:
    begin(tmp_path)
    with pytest.raises(InvalidInputError, match=next(iter(changed))):
        begin(tmp_path, replace(INFO, **changed), is_resumed=True)


@pytest.mark.parametrize(
    ("path", "before", "now"),
    [("stage.extent_m", 30.0, 50.0), ("sensors.cameras.0.width_px", 64, 320), ("seed", 0, 5)],
)
def test_the_key_of_a_configuration_that_differs_is_named(
    tmp_path: Path, path: str, before: float, now: float
) -> None:
    def info(value: float) -> DatasetInfo:
        changed: Any = CONFIG.model_dump()
        *parents, key = [int(part) if part.isdecimal() else part for part in path.split(".")]
        reduce(getitem, parents, changed)[key] = value
        return dataset_info(SimulationConfig.model_validate(changed), 4, 3, INFO.splits)

    begin(tmp_path, info(before))
    expected = f"{path}: received {now!r}, expected {before!r}, as the data set was begun"
    with pytest.raises(InvalidInputError, match=re.escape(expected)):
        begin(tmp_path, info(now), is_resumed=True)


def test_the_first_difference_of_json_data_has_its_path() -> None:
    before = {"a": [1, {"b": 2}], "c": None}
    assert first_difference(before, {"a": [1, {"b": 2}], "c": None}) is None
    assert first_difference(before, {"a": [1, {"b": 3}]}) == ("a.1.b", 2, 3)
    assert first_difference(before, {"a": [1], "c": None}) == ("a.1", {"b": 2}, None)
    assert first_difference(before, {**before, "d": 4}) == ("d", None, 4)


def test_a_data_set_gets_more_worlds(tmp_path: Path) -> None:
    begin(tmp_path)
    assert len(begin(tmp_path, replace(INFO, worlds=9), is_resumed=True).left) == 9
    assert open_dataset(tmp_path).info.worlds == 9


def test_finished_worlds_are_kept_and_their_classes_counted(tmp_path: Path) -> None:
    arrays = write_dataset(tmp_path, {0: "train", 2: "train"})
    open_place(tmp_path).write(HEAD, INFO.to_json().encode())
    left = begin(tmp_path, is_resumed=True)
    assert [task.index for task in left.left] == [1, 3]
    assert left.summary.kept == 2
    images = [each["semantic_0"] for each in arrays.values()]
    for label_id in range(3):
        count = sum(int((image == label_id).sum()) for image in images)
        assert left.summary.label_pixels[label_id] == count
    assert set(left.summary.class_shares()) == {"", "rock", "sand"}
    assert sum(left.summary.class_shares().values()) == pytest.approx(1)


def test_two_commands_do_not_write_to_one_folder(tmp_path: Path) -> None:
    with rendering(tmp_path).begin(is_resumed=False), pytest.raises(NotReadyError, match="another"):
        begin(tmp_path, is_resumed=True)
    begin(tmp_path, is_resumed=True)


def test_half_written_files_of_a_killed_command_are_removed(tmp_path: Path) -> None:
    left = tmp_path / "shards" / ".world_000001.tar.0f.part"
    left.parent.mkdir()
    left.write_bytes(b"half")
    begin(tmp_path, is_resumed=True)
    assert not left.exists()


def test_pixels_of_worlds_that_fail_are_not_counted() -> None:
    summary = DatasetSummary(planned=2)
    for world in (0, 1):
        summary.count(ViewCounts(world, 0, 2, {1: 30, 2: 10}))
    assert summary.views_done(3) == 2
    summary.count(WorldFinished(0, {1: "gravel", 2: "sand"}))
    summary.count(WorldFailure(1, "train", 7, "no view"))
    assert summary.class_shares() == {"gravel": 0.75, "sand": 0.25}
    assert summary.frames == 4
    assert summary.views_done(3) == 6
