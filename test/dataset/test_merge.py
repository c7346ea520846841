"""Several data sets become one, whole and with nothing changed but numbers, or are refused."""

from __future__ import annotations

import json
import shutil
import tarfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from small_datasets import SCANNED, SMALL, render_dataset
from typer.testing import CliRunner

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.check import check_dataset
from oaisys_dataset.cli.dataset import dataset_app
from oaisys_dataset.formats.base import format_names
from oaisys_dataset.formats.export import export_dataset
from oaisys_dataset.manifest import DatasetInfo, WorldFailure
from oaisys_dataset.merging import merge_datasets
from oaisys_dataset.places import open_place
from oaisys_dataset.rendering.dataset_rendering import DatasetRendering, dataset_info
from oaisys_dataset.repeat import repeat_records
from oaisys_dataset.shards import HEAD, manifest_name, tar_name, write_failure, writing_shard

OTHER_ROCKS: dict[str, Any] = {
    **SCANNED,
    "assets": {"rocks": [{"count": [40, 40], "size_m": [0.5, 1.5]}]},
}
"""Worlds that no other set has, although the seeds are the same."""


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two worlds of two views in splits of their own, the second of which could not be made."""
    folder = tmp_path_factory.mktemp("other") / "set"
    render_dataset(folder, {0: "test", 1: "train"}, 2, OTHER_ROCKS)
    for file in (folder / "shards").glob("world_000001.*"):
        file.unlink()
    write_failure(open_place(folder), WorldFailure(1, "train", 1001, "no free view"))
    return folder


@pytest.fixture(scope="module")
def merged(scanned: Dataset, other: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The two worlds of `scanned`, and those of `other` as worlds 2 and 3."""
    folder = tmp_path_factory.mktemp("merged") / "set"
    result = CliRunner().invoke(
        dataset_app, ["merge", scanned.place.url, str(other), "--out", str(folder)]
    )
    assert result.exit_code == 0, result.output
    assert f"{other}: worlds 0 to 1 now worlds 2 to 3; 1 of them could not be made" in result.output
    assert "3 worlds (train, val, test), 8 frames" in result.output
    return folder


def members(tar: Path) -> dict[str, bytes]:
    with tarfile.open(tar) as opened:
        files = [(each.name, opened.extractfile(each)) for each in opened.getmembers()]
        return {name: file.read() for name, file in files if file is not None}


def lines(file: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]


def test_worlds_of_the_first_set_keep_every_byte(merged: Path, scanned: Dataset) -> None:
    for file in sorted(Path(scanned.place.url, "shards").iterdir()):
        assert (merged / "shards" / file.name).read_bytes() == file.read_bytes(), file.name


def test_worlds_of_the_second_set_have_new_numbers_and_nothing_else(
    merged: Path, other: Path
) -> None:
    """Read with tarfile, json and pyarrow alone."""
    before = members(other / "shards/world_000000.tar")
    now = members(merged / "shards/world_000002.tar")
    assert [name.replace("000000_", "000002_", 1) for name in before] == list(now)
    assert list(before.values()) == list(now.values())
    for kind, names in (("jsonl", "images"), ("scans.jsonl", "points")):
        old = lines(other / f"shards/world_000000.{kind}")
        new = lines(merged / f"shards/world_000002.{kind}")
        assert len(old) == len(new) > 0
        for a, b in zip(old, new, strict=True):
            changed = {name for name in a if a[name] != b[name]}
            ids = {"frame_id"} if kind == "jsonl" else {"scan_id"}
            assert changed == {"world", "sha256", names} | ids
            assert b["world"] == 2
    old_rows = pq.read_table(other / "shards/world_000000.objects.parquet").to_pylist()
    new_rows = pq.read_table(merged / "shards/world_000002.objects.parquet").to_pylist()
    assert len(old_rows) == len(new_rows) > 0
    for row, renumbered in zip(old_rows, new_rows, strict=True):
        name = row["frame_id"].replace("000000_", "000002_", 1)
        assert {**row, "frame_id": name, "world": 2} == renumbered


def test_the_head_says_where_each_world_comes_from(merged: Path, other: Path) -> None:
    head = json.loads((merged / HEAD).read_text(encoding="utf-8"))
    assert head["worlds"] == 4
    assert head["views"] == 3
    # One world of two in each, of train and val there and of test and train here.
    assert head["splits"] == pytest.approx({"train": 0.5, "val": 0.25, "test": 0.25})
    assert [part["first_world"] for part in head["merged"]] == [0, 2]
    assert head["merged"][1]["place"] == str(other)
    assert head["merged"][1]["config"]["assets"]["rocks"][0]["count"] == [40, 40]
    failed = json.loads((merged / "failed/world_000003.json").read_text(encoding="utf-8"))
    assert (failed["world"], failed["reason"]) == (3, "no free view")


@pytest.mark.long
def test_the_check_passes_each_world_by_its_own_configuration(merged: Path) -> None:
    report = check_dataset(merged, worlds_rebuilt=3)
    assert report.findings == ()
    assert (report.worlds, report.frames, report.rebuilt_worlds) == (3, 8, (0, 1, 2))
    assert report.points > 8 * 300
    assert report.failed_worlds == (3,)


def test_the_check_finds_a_head_that_was_changed(merged: Path, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    shutil.copytree(merged, folder)
    head = json.loads((folder / HEAD).read_text(encoding="utf-8"))
    head["merged"][1]["seed"] += 1
    (folder / HEAD).write_text(json.dumps(head), encoding="utf-8")
    (finding,) = check_dataset(folder, worlds_rebuilt=0).findings
    assert (finding.check, finding.subject) == ("head", f"{HEAD}, from world 2")
    head["merged"][1]["first_world"] = 1
    (folder / HEAD).write_text(json.dumps(head), encoding="utf-8")
    with pytest.raises(InvalidInputError, match="first_world"):
        open_dataset(folder)


@pytest.mark.long
def test_frames_and_scans_of_all_parts_are_repeated(merged: Path) -> None:
    ids = ["000002_0001_camera", "000000_0000_camera", "000002_0000_roof"]
    repeated = dict(repeat_records(open_dataset(merged), ids, 60.0))
    assert repeated.keys() == set(ids)
    assert all(each.is_equal for comparisons in repeated.values() for each in comparisons)


@pytest.mark.long
def test_all_formats_take_a_merged_set(merged: Path, tmp_path: Path) -> None:
    dataset = open_dataset(merged)
    for name in format_names():
        counts = export_dataset(dataset, name, tmp_path / name)
        assert counts, name
    boxes = json.loads((tmp_path / "coco/annotations/instances_test.json").read_text())
    assert {image["file_name"] for image in boxes["images"]} == {
        f"000002_000{view}_camera.png" for view in range(2)
    }
    assert sorted(each.name for each in (tmp_path / "files").glob("from_world_*")) == [
        "from_world_000000",
        "from_world_000002",
    ]


@pytest.mark.long
def test_a_merged_set_can_be_merged_again(merged: Path, tmp_path: Path) -> None:
    config = {**SCANNED, "stage": {**SCANNED["stage"], "extent_m": 41.0}}
    render_dataset(tmp_path / "more", {0: "train"}, 1, config)
    merge_datasets([tmp_path / "more", merged], tmp_path / "all")
    dataset = open_dataset(tmp_path / "all")
    assert dataset.worlds == (0, 1, 2, 3)
    assert [part.first_world for part in dataset.info.merged] == [0, 1, 3]
    assert dataset.info.merged[1].place != str(merged)
    assert dataset.failures[0].world == 4


def test_a_merged_set_is_not_continued(merged: Path) -> None:
    config = config_from_mapping(SCANNED)
    rendering = DatasetRendering(open_place(merged), config, dataset_info(config, 9, 3, {"a": 1}))
    with (
        pytest.raises(InvalidInputError, match="continue those that it was merged from"),
        rendering.begin(is_resumed=True),
    ):
        pass


def camera(**changes: Any) -> dict[str, Any]:
    (one,) = SMALL["sensors"]["cameras"]
    return {**OTHER_ROCKS, "sensors": {**SCANNED["sensors"], "cameras": [{**one, **changes}]}}


REFUSED = [
    (SCANNED, r"set: world: received 0, expected other worlds than those of .* world 0"),
    (camera(modalities=["rgb", "depth"]), r"modalities of camera: received 'depth, rgb', expected"),
    (camera(width_px=90), r"size of camera: received '90x72', expected 96x72"),
    (camera(name="eye"), r"sensors: received 'eye, front, roof, rosette', expected camera, front"),
    (
        {**OTHER_ROCKS, "sensors": SMALL["sensors"]},
        r"sensors: received 'camera', expected camera, ",
    ),
]


@pytest.mark.long
@pytest.mark.parametrize(("config", "message"), REFUSED)
def test_sets_that_differ_are_refused(
    config: dict[str, Any], message: str, scanned: Dataset, tmp_path: Path
) -> None:
    render_dataset(tmp_path / "set", {0: "train"}, 1, config)
    with pytest.raises(InvalidInputError, match=message):
        merge_datasets([scanned.place.url, tmp_path / "set"], tmp_path / "out")
    assert [each.name for each in tmp_path.iterdir()] == ["set"]


CHANGES: list[Callable[[dict[str, Any]], Any]] = [
    lambda config: config["stage"].update(preset="mesa"),
    lambda config: config["sensors"]["cameras"][0].update(fx_px=10.0),
    lambda config: config["assets"].pop("rocks"),
]


@pytest.mark.parametrize("change", CHANGES)
def test_a_set_whose_configuration_was_changed_is_refused(
    change: Callable[[dict[str, Any]], Any], rendered: Dataset, other: Path, tmp_path: Path
) -> None:
    folder, out = tmp_path / "set", tmp_path / "out"
    shutil.copytree(rendered.place.url, folder)
    head = json.loads((folder / HEAD).read_text(encoding="utf-8"))
    change(head["config"])
    (folder / HEAD).write_text(json.dumps(head), encoding="utf-8")
    message = rf"set: dataset\.json: config: received 'a configuration .*{head['config_sha256']}"
    with pytest.raises(InvalidInputError, match=message):
        merge_datasets([other, folder], out)
    with pytest.raises(InvalidInputError, match=message):
        export_dataset(open_dataset(folder), "files", out)
    assert not out.exists()


def relabelled(folder: Path, change: Callable[[dict[int, str]], dict[int, str]]) -> None:
    """Write the legend of world 0 with other labels."""
    dataset = open_dataset(folder)
    samples = [dataset.sample(record) for record in dataset.of_world(0)]
    legend = dataset.legend(0)
    with writing_shard(dataset.place, 0) as shard:
        for sample in samples:
            shard.add(sample.record, sample.arrays)
        shard.finish(replace(legend, labels=change(dict(legend.labels))))


@pytest.mark.long
def test_legends_are_joined_or_refused(tmp_path: Path) -> None:
    sets = [tmp_path / "first", tmp_path / "second"]
    render_dataset(sets[0], {0: "train"}, 1, SMALL)
    render_dataset(sets[1], {0: "train"}, 1, {**SMALL, "assets": OTHER_ROCKS["assets"]})
    labels = dict(open_dataset(sets[0]).legend(0).labels)
    label_id, label = next(iter(labels.items()))

    relabelled(sets[1], lambda known: {**known, label_id: "lava"})
    with pytest.raises(InvalidInputError, match=rf"second: label {label_id}: received .*lava"):
        merge_datasets(sets, tmp_path / "out")

    others = {each: name for each, name in labels.items() if each != label_id}
    relabelled(sets[1], lambda _: {**others, 900: label})
    with pytest.raises(InvalidInputError, match=rf"id of '{label}': received 900, expected"):
        merge_datasets(sets, tmp_path / "out")
    assert not (tmp_path / "out").exists()

    relabelled(sets[1], lambda _: {**labels, 901: "ice"})
    merge_datasets(sets, tmp_path / "out")
    merged = open_dataset(tmp_path / "out")
    assert merged.legend(0).labels == labels
    assert merged.legend(1).labels == {**labels, 901: "ice"}


def cut_tar(folder: Path) -> None:
    file = folder / tar_name(0)
    file.write_bytes(file.read_bytes()[:20_000])


def flip_pixel(folder: Path) -> None:
    image = open_dataset(folder).record("000000_0001_camera").images["depth"]
    data = bytearray((folder / tar_name(0)).read_bytes())
    data[image.offset + image.size // 2] ^= 1
    (folder / tar_name(0)).write_bytes(data)


def flip_digit(folder: Path) -> None:
    file = folder / manifest_name(0)
    file.write_bytes(file.read_bytes().replace(b'"view":1', b'"view":1 ', 1))
    text = file.read_bytes()
    at = text.rindex(b'"T_map_camera":[[') + 20
    file.write_bytes(text[:at] + bytes([text[at] ^ 1]) + text[at + 1 :])


def drop_world(folder: Path) -> None:
    (folder / "failed/world_000001.json").unlink()


@pytest.mark.parametrize("damage", [cut_tar, flip_pixel, flip_digit, drop_world])
def test_nothing_is_left_of_a_merge_that_fails(
    damage: Callable[[Path], None], scanned: Dataset, other: Path, tmp_path: Path
) -> None:
    shutil.copytree(other, tmp_path / "set")
    damage(tmp_path / "set")
    with pytest.raises(InvalidInputError):
        merge_datasets([scanned.place.url, tmp_path / "set"], tmp_path / "out")
    assert [each.name for each in tmp_path.iterdir()] == ["set"]


def test_a_set_at_a_url_has_its_head_last(scanned: Dataset, other: Path, tmp_path: Path) -> None:
    url = f"memory://merged-{tmp_path.name}"
    merge_datasets([scanned.place.url, other], url)
    assert open_dataset(url).worlds == (0, 1, 2)

    shutil.copytree(other, tmp_path / "set")
    flip_pixel(tmp_path / "set")
    with pytest.raises(InvalidInputError):
        merge_datasets([scanned.place.url, tmp_path / "set"], f"{url}-failed")
    assert open_place(f"{url}-failed").is_empty()


def test_the_place_must_be_empty_and_the_sets_several(
    merged: Path, scanned: Dataset, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInputError, match="at least two"):
        merge_datasets([scanned.place.url], tmp_path / "out")
    with pytest.raises(InvalidInputError, match="does not exist or is empty"):
        merge_datasets([scanned.place.url, merged], merged)


def test_an_ordinary_head_has_no_word_of_merging() -> None:
    info = dataset_info(config_from_mapping(SMALL), 2, 3, {"train": 1.0})
    assert "merged" not in json.loads(info.to_json())
    assert DatasetInfo.from_json(info.to_json()) == info
    assert np.array_equal([part.first_world for part in info.parts], [0])
