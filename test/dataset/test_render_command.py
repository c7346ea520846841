"""`oaisys dataset render` and `repeat` refuse wrong input before anything is rendered."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from dataset_runs import CONFIG, write_config
from synthetic_datasets import write_dataset
from typer.testing import CliRunner

from oaisys_core.errors import InvalidInputError
from oaisys_dataset import Dataset
from oaisys_dataset.cli.dataset import dataset_app
from oaisys_dataset.repeat import repeat_records

COLOUR_ONLY = CONFIG.replace("[rgb, depth, semantic_0, instance, normal]", "[rgb]")
FISHEYE = CONFIG.replace("fy_px: 54.0", "fy_px: 54.0\n      fisheye: {k1: 0.01}")


STILL = re.sub(r"  motion: .*\n", "", CONFIG)


@pytest.mark.parametrize(
    ("text", "options", "expected"),
    [
        (STILL, ["--views", "5"], "sensors.motion.kind: received 'given', expected a motion"),
        (CONFIG, ["--splits", "train=0.5,val=0.4"], "shares whose sum is 1, not 0.9"),
        (CONFIG, ["--splits", "train=1,train=0"], "splits: received 'train=0'"),
        (CONFIG, ["--formats", "coco,webdatset"], "(did you mean webdataset?)"),
        (COLOUR_ONLY, ["--formats", "tum"], "modalities: received 'rgb', expected also depth"),
        (FISHEYE, ["--formats", "files,kitti"], "sensors: received 'camera', expected no fisheye"),
        (CONFIG, ["--size", "320"], "size: received '320', expected WIDTHxHEIGHT"),
        (CONFIG, ["--quality", "hihg"], "quality: received 'hihg'"),
    ],
)
def test_wrong_options_are_refused_before_rendering(
    tmp_path: Path, text: str, options: list[str], expected: str
) -> None:
    out = tmp_path / "set"
    line = ["render", str(write_config(tmp_path, text)), "--out", str(out), *options]
    with pytest.raises(InvalidInputError, match=re.escape(expected)):
        CliRunner().invoke(dataset_app, line, catch_exceptions=False)
    assert not out.exists()


@pytest.mark.parametrize("option", ["--worlds", "--views", "--num-workers", "--memory-per-worker"])
def test_a_number_of_none_is_refused(tmp_path: Path, option: str) -> None:
    line = ["render", str(write_config(tmp_path)), "--out", str(tmp_path / "set"), option, "0"]
    result = CliRunner().invoke(dataset_app, line)
    assert result.exit_code == 2
    assert not (tmp_path / "set").exists()


def test_a_data_set_is_in_a_folder_of_the_working_directory_by_default(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_dataset("out/dataset", {0: "train"}, views=1)
    line = ["render", str(write_config(tmp_path))]
    with pytest.raises(InvalidInputError, match="out: received 'out/dataset'"):
        CliRunner().invoke(dataset_app, line, catch_exceptions=False)


def test_a_place_with_another_set_is_refused(tmp_path: Path) -> None:
    write_dataset(tmp_path / "set", {0: "train"}, views=1)
    line = ["render", str(write_config(tmp_path)), "--out", str(tmp_path / "set")]
    with pytest.raises(InvalidInputError, match="a place without a data set, or --resume"):
        CliRunner().invoke(dataset_app, line, catch_exceptions=False)
    with pytest.raises(InvalidInputError, match="as the data set was begun"):
        CliRunner().invoke(dataset_app, [*line, "--resume"], catch_exceptions=False)


def test_a_frame_that_is_not_there_is_wrong_input(rendered: Dataset) -> None:
    with pytest.raises(InvalidInputError, match=r"'000009_0000_camera', .* such as 000000_0000_"):
        list(repeat_records(rendered, ["000000_0000_camera", "000009_0000_camera"], 40.0))
