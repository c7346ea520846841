"""`oaisys dataset check` passes what was rendered, and finds whatever was damaged afterwards."""

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from small_datasets import SMALL, render_dataset
from typer.testing import CliRunner

from oaisys_core.config import config_from_mapping
from oaisys_core.output.records import intrinsics_record
from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.check import CheckReport, check_dataset
from oaisys_dataset.check.view_truth import normal_faults
from oaisys_dataset.cli.dataset import dataset_app
from oaisys_dataset.manifest import FrameRecord, LegendInstance, WorldFailure
from oaisys_dataset.places import open_place
from oaisys_dataset.plan import world_tasks
from oaisys_dataset.rendering.dataset_rendering import dataset_info
from oaisys_dataset.rendering.workers import write_world
from oaisys_dataset.rendering.world_render import WorldRenderer
from oaisys_dataset.shards import (
    HEAD,
    manifest_name,
    tar_name,
    write_failure,
    writing_shard,
)

WORLDS = {0: "train", 1: "train", 2: "val"}
VIEWS = 3


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rendered")
    render_dataset(folder, WORLDS, VIEWS)
    return folder


@pytest.fixture
def folder(rendered: Path, tmp_path: Path) -> Path:
    copy = tmp_path / "set"
    shutil.copytree(rendered, copy)
    return copy


def checks(report: CheckReport) -> set[str]:
    return {finding.check for finding in report.findings}


def test_what_was_rendered_passes(rendered: Path) -> None:
    report = check_dataset(rendered, worlds_rebuilt=1)
    assert report.findings == ()
    assert report.has_passed
    assert (report.worlds, report.frames, report.images) == (3, 9, 45)
    assert report.splits == {"train": 2, "val": 1}
    assert len(report.rebuilt_worlds) == 1
    assert report.points > 3 * 300
    assert {each.modality for each in report.audited} == {"depth", "semantic_0", "instance"}
    assert all(each.pixels > 700 for each in report.audited)


def test_normals_under_a_sky_pass_without_warnings(rendered: Path) -> None:
    dataset = open_dataset(rendered)
    sample = dataset.sample(next(iter(dataset.of_world(0))))
    depth_m, normals = sample.arrays["depth"].copy(), sample.arrays["normal"].copy()
    depth_m[: len(depth_m) // 2], normals[: len(normals) // 2] = np.inf, 0
    below = replace(sample, arrays={**sample.arrays, "depth": depth_m, "normal": normals})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert list(normal_faults(below)) == []


@pytest.mark.long
def test_what_cannot_be_audited_is_said_and_does_not_fail(tmp_path: Path) -> None:
    (camera,) = SMALL["sensors"]["cameras"]
    fisheye = {**camera, "name": "wide", "fx_px": 40.0, "fy_px": 40.0, "fisheye": {"k1": 0.01}}
    rolling = {**camera, "name": "rolling", "readout_s": 0.05, "mount_position_m": [0, 0.5, 0]}
    sensors = {**SMALL["sensors"], "cameras": [camera, fisheye, rolling]}
    render_dataset(tmp_path, {0: "train"}, VIEWS, {**SMALL, "sensors": sensors})

    report = check_dataset(tmp_path, worlds_rebuilt=1)

    assert report.findings == ()
    assert {each.sensor for each in report.audited} == {"camera"}
    # Of the fisheye, depth is compared with the surface.
    assert report.points > 2 * 300
    assert any("rolling has a rolling shutter" in note for note in report.notes)
    assert any("wide is a fisheye" in note for note in report.notes)


def test_objects_that_reach_over_the_edge_of_the_stage_pass(tmp_path: Path) -> None:
    boxes = [
        {"shape": "box", "size_m": [2.0, 2.0, 0.4], "position_m": [x, y, 0.0]}
        for x, y in ((5.0, 0.0), (-5.0, 0.0), (0.0, 5.0), (0.0, -5.0))
    ]
    config = {
        **SMALL,
        "stage": {"preset": "plane", "extent_m": 10.0, "resolution_px": 33},
        "assets": {"rocks": [], "primitives": boxes},
        "sensors": {
            "lidars": [
                {
                    "name": "roof",
                    "scan": {"kind": "rotating", "channels": 32, "azimuth_steps": 180},
                }
            ],
            "start_pose": {"position_m": [0.0, 0.0, 2.0]},
        },
    }
    render_dataset(tmp_path / "set", {0: "train"}, 1, config)
    report = check_dataset(tmp_path / "set", worlds_rebuilt=1)
    assert report.findings == ()
    assert report.points > 50


@pytest.mark.long
def test_ground_that_is_finer_around_each_view_passes(tmp_path: Path) -> None:
    detail = {"radius_m": 6.0, "spacing_m": 0.05, "amplitude_m": 0.2}
    config = {**SMALL, "stage": {**SMALL["stage"], "detail": detail}}
    render_dataset(tmp_path, {0: "train"}, 5, config)
    report = check_dataset(tmp_path, worlds_rebuilt=1)
    assert report.findings == ()
    assert report.points > 2 * 300


def changed_bytes(file: Path, offset: int) -> None:
    data = bytearray(file.read_bytes())
    data[offset] ^= 1
    file.write_bytes(data)


def rewritten(
    folder: Path,
    world: int,
    change: Callable[[FrameRecord, dict[str, Any]], tuple[FrameRecord, dict[str, Any]]],
    as_world: int | None = None,
) -> None:
    """Write a world again as if it had been rendered like this: all hashes are right."""
    dataset = open_dataset(folder)
    samples = [dataset.sample(record) for record in dataset.of_world(world)]
    legend = dataset.legend(world)
    with writing_shard(dataset.place, world if as_world is None else as_world) as shard:
        for sample in samples:
            shard.add(*change(sample.record, dict(sample.arrays)))
        shard.finish(legend)


def image_offset(dataset: Dataset, frame: str, modality: str) -> int:
    image = dataset.record(frame).images[modality]
    return image.offset + image.size // 2


def flip_image_byte(folder: Path) -> None:
    offset = image_offset(open_dataset(folder), "000001_0001_camera", "normal")
    changed_bytes(folder / tar_name(1), offset)


def flip_manifest_byte(folder: Path) -> None:
    file = folder / manifest_name(1)
    offset = file.read_bytes().index(b'"T_map_camera":[[') + 20
    changed_bytes(file, offset)


def flip_legend_byte(folder: Path) -> None:
    file = folder / tar_name(2)
    changed_bytes(file, file.read_bytes().rindex(b'"labels":{') + 17)


def flip_tar_header(folder: Path) -> None:
    image = open_dataset(folder).record("000000_0002_camera").images["rgb"]
    changed_bytes(folder / tar_name(0), image.offset - 512)


def drop_line(folder: Path) -> None:
    file = folder / manifest_name(2)
    first, _, last = file.read_text(encoding="utf-8").splitlines(keepends=True)
    file.write_text(first + last, encoding="utf-8")


def cut_tar(folder: Path) -> None:
    file = folder / tar_name(1)
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def swap_files(folder: Path) -> None:
    """Exchange two images in the tar file."""
    dataset, file = open_dataset(folder), folder / tar_name(0)
    a, b = (dataset.record(f"000000_000{v}_camera").images["semantic_0"] for v in (0, 1))
    data = bytearray(file.read_bytes())
    size = min(a.size, b.size)
    at_a, at_b = data[a.offset :][:size], data[b.offset :][:size]
    data[a.offset : a.offset + size], data[b.offset : b.offset + size] = at_b, at_a
    file.write_bytes(data)


def swap_pixels(folder: Path) -> None:
    """Give each view the depth of the next one, with hashes that fit."""
    dataset = open_dataset(folder)
    depths = [dataset.sample(r).arrays["depth"] for r in dataset.of_world(0)]

    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        return record, {**arrays, "depth": depths[(record.view + 1) % VIEWS]}

    rewritten(folder, 0, change)


def change_K(folder: Path) -> None:  # noqa: N802 - the field's name for the camera matrix
    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        camera = replace(record.camera, fx_px=record.camera.fx_px * 1.02)
        return replace(record, intrinsics=intrinsics_record(camera)), arrays

    rewritten(folder, 0, change)


def change_axes(folder: Path) -> None:
    """Write poses for a camera that looks along -z, with y up."""

    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        T = record.pose @ np.diag((1.0, -1.0, -1.0, 1.0))
        return replace(record, T_map_camera=tuple(map(tuple, T.tolist()))), arrays

    rewritten(folder, 0, change)


def mirror_axes(folder: Path) -> None:
    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        T = record.pose @ np.diag((1.0, -1.0, 1.0, 1.0))
        return replace(record, T_map_camera=tuple(map(tuple, T.tolist()))), arrays

    rewritten(folder, 0, change)


def scale_depth(folder: Path) -> None:
    """Write depths that are 0.1 % too large."""

    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        return record, {**arrays, "depth": arrays["depth"] * np.float32(1.001)}

    rewritten(folder, 0, change)


def shift_labels(folder: Path) -> None:
    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        return record, {**arrays, "semantic_0": np.roll(arrays["semantic_0"], 3, axis=1)}

    rewritten(folder, 0, change)


def unknown_id(folder: Path) -> None:
    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        instance = arrays["instance"].copy()
        instance[5, 5] = 4321
        return record, {**arrays, "instance": instance}

    rewritten(folder, 1, change)


def two_splits(folder: Path) -> None:
    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        return replace(record, split="val" if record.view else "train"), arrays

    rewritten(folder, 1, change)


def same_world_in_another_split(folder: Path) -> None:
    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        name = f"000002{record.frame_id[6:]}"
        return replace(record, world=2, frame_id=name, split="val"), arrays

    rewritten(folder, 0, change, as_world=2)


def repeat_frame(folder: Path) -> None:
    dataset = open_dataset(folder)
    first = dataset.sample(dataset.record("000001_0000_camera")).arrays

    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        return record, dict(first) if record.view == 1 else arrays

    rewritten(folder, 1, change)


def drop_world(folder: Path) -> None:
    (folder / manifest_name(1)).unlink()


def drop_view(folder: Path) -> None:
    dataset = open_dataset(folder)
    samples = [dataset.sample(record) for record in dataset.of_world(1)]
    legend = dataset.legend(1)
    with writing_shard(dataset.place, 1) as shard:
        for sample in samples[:2]:
            shard.add(sample.record, sample.arrays)
        shard.finish(legend)


def change_config(folder: Path) -> None:
    head = json.loads((folder / "dataset.json").read_text(encoding="utf-8"))
    head["config"]["seed"] += 1
    (folder / "dataset.json").write_text(json.dumps(head), encoding="utf-8")


def negate_normals(folder: Path) -> None:
    change_normals(folder, lambda normals, _: -normals)


def turn_normals_into_map(folder: Path) -> None:
    change_normals(folder, lambda normals, R: normals @ R.T)


def shorten_normals(folder: Path) -> None:
    change_normals(folder, lambda normals, _: 0.98 * normals)


def flip_normals(folder: Path) -> None:
    """Write normals with y up, as OpenGL has them."""
    change_normals(folder, lambda normals, _: normals * (1, -1, 1))


def change_normals(folder: Path, change: Callable[[Any, Any], Any]) -> None:
    def change_all(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        normals = np.ascontiguousarray(change(arrays["normal"], record.pose[:3, :3]), np.float32)
        return record, {**arrays, "normal": normals}

    rewritten(folder, 0, change_all)


def move_sun(folder: Path) -> None:
    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        assert record.sun_azimuth_deg is not None
        return replace(record, sun_azimuth_deg=record.sun_azimuth_deg + 0.01), arrays

    rewritten(folder, 0, change)


def move_stamp(folder: Path) -> None:
    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        return replace(record, stamp_s=record.stamp_s + 0.05), arrays

    rewritten(folder, 0, change)


def change_label_pixels(folder: Path) -> None:
    """Count a pixel too many in a line whose hash fits."""
    file = folder / manifest_name(1)
    first, *others = file.read_bytes().splitlines()
    record = FrameRecord.from_json(first, "line")
    changed = {each: count + 1 for each, count in record.label_pixels.items()}
    line = replace(record, label_pixels=changed).to_json().encode().rstrip()
    file.write_bytes(b"\n".join([line, *others]) + b"\n")


def rename_object(folder: Path) -> None:
    change_legend(folder, lambda told: replace(told, name=f"{told.name}_x"))


def relabel_object(folder: Path) -> None:
    change_legend(folder, lambda told: replace(told, label="sand"))


def change_legend(folder: Path, change: Callable[[LegendInstance], LegendInstance]) -> None:
    """Write the legend of world 0 with a changed first object, and hashes that fit."""
    dataset = open_dataset(folder)
    samples = [dataset.sample(record) for record in dataset.of_world(0)]
    legend = dataset.legend(0)
    first = min(legend.instances)
    changed = {**legend.instances, first: change(legend.instances[first])}
    with writing_shard(dataset.place, 0) as shard:
        for sample in samples:
            shard.add(sample.record, sample.arrays)
        shard.finish(replace(legend, instances=changed))


def append_to_tar(folder: Path) -> None:
    with (folder / tar_name(1)).open("ab") as file:
        file.write(b"more")


def append_zeros_to_tar(folder: Path) -> None:
    with (folder / tar_name(1)).open("ab") as file:
        file.write(bytes(50_000))


def change_head(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    head = json.loads((folder / HEAD).read_text(encoding="utf-8"))
    change(head)
    (folder / HEAD).write_text(json.dumps(head), encoding="utf-8")


def change_seed(folder: Path) -> None:
    change_head(folder, lambda head: head.update(seed=head["seed"] + 1))


def drop_default(folder: Path) -> None:
    """Leave a default out, which gives the same hash but is another configuration to read."""
    change_head(folder, lambda head: head["config"]["sensors"].pop("lidars"))


def lower_views(folder: Path) -> None:
    change_head(folder, lambda head: head.update(views=VIEWS - 1))


def raise_shares(folder: Path) -> None:
    change_head(folder, lambda head: head["splits"].update(train=0.9))


def drop_modality(folder: Path) -> None:
    """Write a world without normals: all that is there fits."""

    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        return record, {name: data for name, data in arrays.items() if name != "normal"}

    rewritten(folder, 1, change)


def add_modality(folder: Path) -> None:
    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        return record, {**arrays, "semantic_1": arrays["semantic_0"]}

    rewritten(folder, 1, change)


def rename_sensor(folder: Path) -> None:
    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        name = record.frame_id.replace("camera", "eye")
        return replace(record, frame_id=name, sensor="eye"), arrays

    rewritten(folder, 1, change)


def break_failure(folder: Path) -> None:
    drop_world(folder)
    (folder / tar_name(1)).unlink()
    (folder / "failed").mkdir()
    (folder / "failed/world_000001.json").write_text('{"world": 1', encoding="utf-8")


def fail_another_world(folder: Path) -> None:
    write_failure(open_place(folder), WorldFailure(1, "train", 1001, "no free view"))
    failed = folder / "failed"
    (failed / "world_000001.json").rename(failed / "world_000002.json")
    for name in (manifest_name(2), tar_name(2)):
        (folder / name).unlink()


def fail_a_finished_world(folder: Path) -> None:
    write_failure(open_place(folder), WorldFailure(1, "train", 1001, "no free view"))


def fail_in_an_unknown_split(folder: Path) -> None:
    drop_world(folder)
    (folder / tar_name(1)).unlink()
    write_failure(open_place(folder), WorldFailure(1, "night", 1001, "no free view"))


def invent_draws(folder: Path) -> None:
    """Say that a value was drawn which the configuration gives."""

    def change(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        return replace(record, metadata={"drawn": {"stage.preset": "canyon"}}), arrays

    rewritten(folder, 0, change)


DAMAGE = [
    (change_seed, {"head"}),
    (drop_default, {"head"}),
    (lower_views, {"manifest"}),
    (raise_shares, {"head"}),
    (drop_modality, {"missing"}),
    (add_modality, {"missing"}),
    (rename_sensor, {"manifest", "missing"}),
    (break_failure, {"manifest"}),
    (fail_another_world, {"manifest"}),
    (fail_a_finished_world, {"head"}),
    (fail_in_an_unknown_split, {"split"}),
    (invent_draws, {"camera"}),
    (negate_normals, {"surface"}),
    (turn_normals_into_map, {"surface"}),
    (shorten_normals, {"surface"}),
    (flip_normals, {"surface"}),
    (move_sun, {"camera"}),
    (move_stamp, {"camera"}),
    (change_label_pixels, {"manifest"}),
    (rename_object, {"labels"}),
    (relabel_object, {"labels"}),
    (append_to_tar, {"shard"}),
    (append_zeros_to_tar, {"shard"}),
    (flip_image_byte, {"hash"}),
    (flip_manifest_byte, {"manifest"}),
    (flip_legend_byte, {"shard"}),
    (flip_tar_header, {"shard"}),
    (drop_line, {"manifest", "missing"}),
    (cut_tar, {"shard"}),
    (swap_files, {"hash"}),
    (swap_pixels, {"surface"}),
    (change_K, {"camera"}),
    (change_axes, {"camera", "surface"}),
    (mirror_axes, {"camera"}),
    (scale_depth, {"surface"}),
    (shift_labels, {"labels"}),
    (unknown_id, {"legend"}),
    (two_splits, {"split"}),
    (same_world_in_another_split, {"split", "duplicate"}),
    (repeat_frame, {"duplicate"}),
    (drop_world, {"missing"}),
    (drop_view, {"missing"}),
    (change_config, {"head"}),
]


NEED_WORLDS = {"camera", "surface", "labels"}
"""Checks for which a world is made again, which takes a second; their damage is in world 0."""


IN_SOAK = {
    *(shorten_normals, flip_normals, turn_normals_into_map, invent_draws, mirror_axes),
    relabel_object,
}
"""Damage of the same values as another one, found by the same check."""


def _case(damage: Callable[[Path], None], expected: set[str]) -> Any:
    marks = [pytest.mark.long] if expected & NEED_WORLDS else []
    marks = [pytest.mark.soak] if damage in IN_SOAK else marks
    return pytest.param(damage, expected, id=damage.__name__, marks=marks)


@pytest.mark.parametrize(("damage", "expected"), [_case(*each) for each in DAMAGE])
def test_damage_is_found(folder: Path, damage: Callable[[Path], None], expected: set[str]) -> None:
    damage(folder)
    if needs_world := bool(expected & NEED_WORLDS):
        for world in (1, 2):
            (folder / manifest_name(world)).unlink()
    report = check_dataset(folder, worlds_rebuilt=int(needs_world))
    assert not report.has_passed
    assert expected <= checks(report), report.findings


def test_a_world_that_was_moved_into_another_split_is_found(tmp_path: Path) -> None:
    """All its lines agree; only the plan of the data set knows better."""
    config = config_from_mapping(SMALL)
    place, info = open_place(tmp_path), dataset_info(config, 2, 2, {"train": 0.5, "val": 0.5})
    place.write(HEAD, info.to_json().encode())
    renderer = WorldRenderer(config, "here")
    for task in world_tasks(info.seed, 2, 2, info.splits):
        list(write_world(place, task, renderer.render(task)))
    renderer.close()
    assert check_dataset(tmp_path, worlds_rebuilt=0).has_passed

    def move(record: FrameRecord, arrays: dict[str, Any]) -> Any:
        return replace(record, split="train"), arrays

    rewritten(tmp_path, 1, move)
    assert "split" in checks(check_dataset(tmp_path, worlds_rebuilt=0))


def test_a_world_that_could_not_be_made_is_counted_and_is_no_finding(folder: Path) -> None:
    (folder / manifest_name(1)).unlink()
    (folder / tar_name(1)).unlink()
    dataset = open_dataset(folder)
    write_failure(dataset.place, WorldFailure(1, "train", 1001, "no free view"))
    report = check_dataset(folder, worlds_rebuilt=0)
    assert report.has_passed
    assert report.failed_worlds == (1,)


@pytest.mark.blender
@pytest.mark.long
def test_what_blender_rendered_shows_the_worlds_that_are_made_again_without_it(
    tmp_path: Path,
) -> None:
    in_blender("datasets.render", str(tmp_path), {0: "train", 1: "val"}, 2)
    report = check_dataset(tmp_path, worlds_rebuilt=2)
    assert report.findings == ()
    assert report.points > 4 * 300
    assert report.scans == 2 * 5
    assert report.scan_points > 4 * 300


def run(*arguments: object) -> Any:
    return CliRunner().invoke(dataset_app, ["check", *map(str, arguments)])


def test_the_command_writes_a_report_and_passes(rendered: Path, tmp_path: Path) -> None:
    out = tmp_path / "report.json"
    result = run(rendered, "--worlds-rebuilt", 1, "--out", out)
    assert result.exit_code == 0, result.output
    assert "3 worlds (2 train, 1 val), 9 frames, 45 images" in result.output
    report = json.loads(out.read_text(encoding="utf-8"))
    assert report["passed"] is True
    assert len(report["rebuilt_worlds"]) == 1
    assert {each["wrong_share"] for each in report["audited"]} == {0.0}


def test_the_command_says_what_is_wrong_and_fails(folder: Path, tmp_path: Path) -> None:
    flip_image_byte(folder)
    out = tmp_path / "report.json"
    result = run(folder, "--worlds-rebuilt", 0, "--out", out)
    assert type(result.exception).__name__ == "DatasetCheckFailedError"
    assert "hash: 000001_0001_camera/normal:" in result.output
    report = json.loads(out.read_text(encoding="utf-8"))
    assert report["passed"] is False
    assert report["findings"][0]["check"] == "hash"


def test_the_command_refuses_what_is_no_data_set(tmp_path: Path) -> None:
    result = run(tmp_path)
    assert type(result.exception).__name__ == "InvalidInputError"
