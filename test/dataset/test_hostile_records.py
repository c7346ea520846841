"""A data set that somebody else wrote: each field of each record is refused where it is read."""

from __future__ import annotations

import json
import os
import re
import shutil
import tarfile
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from commands import oaisys_here
from small_datasets import SCANNED, render_dataset
from synthetic_datasets import write_dataset

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.names import is_name, path_inside
from oaisys_core.output.reader import read_samples
from oaisys_core.output.record_types import MAX_FILE_BYTES
from oaisys_dataset import open_dataset
from oaisys_dataset.check.head import part_plans
from oaisys_dataset.check.shard import check_shard
from oaisys_dataset.formats.base import format_names
from oaisys_dataset.formats.export import export_dataset
from oaisys_dataset.places import MAX_WHOLE_BYTES, open_place
from oaisys_dataset.shards import read_head, tar_name

MANIFEST = "shards/world_000000.jsonl"
HEAD = "dataset.json"

NO_NAMES = (
    *("/tmp/outside", "../../outside", "a/../../b", "a\\..\\b", "C:outside", "C:\\outside"),
    *(
        "..",
        ".",
        "",
        " ",
        ".hidden",
        "end.",
        "a\0b",
        "a\nb",
        "x" * 300,
        "\u202egnp",
        "~root",
        "-rf",
    ),
)
NO_NUMBERS: tuple[Any, ...] = (-1, 10**12, 10**300, True, "7", 1.5, None, [], {})
NO_LENGTHS: tuple[Any, ...] = (float("nan"), float("inf"), -float("inf"), 1e300, "1", None, [])
NO_HASHES = ("", "x", "../../x", "A" * 64, "0" * 63, 7, None)
NO_OBJECTS = ("[", "[]", "7", '{"a": 1, "a": 2}', "[" * 10_000, 7, None)

Change = Callable[[dict[str, Any]], Any]


def put(*path: str | int) -> Callable[[dict[str, Any], Any], None]:
    """Return a function that sets the value at a path in a record."""

    def change(record: Any, value: Any) -> None:
        for key in path[:-1]:
            record = record[key]
        record[path[-1]] = value

    return change


FIELDS: dict[tuple[str | int, ...], tuple[Any, ...]] = {
    ("frame_id",): NO_NAMES,
    ("sensor",): NO_NAMES,
    ("split",): (*NO_NAMES, "a.b", "train-1", 7),
    ("images", "rgb", "file"): NO_NAMES,
    ("world",): NO_NUMBERS,
    ("view",): NO_NUMBERS,
    ("world_seed",): (-1, 2**64, True, "7", None),
    ("stamp_s",): (*NO_LENGTHS, -1),
    ("seconds",): (*NO_LENGTHS, -1),
    ("T_map_camera",): (
        [],
        [[0]],
        [[0] * 4] * 4,
        [[float("nan")] * 4] * 4,
        "",
        {},
        [[1e300] * 4] * 4,
    ),
    ("intrinsics",): ({}, [], None),
    ("intrinsics", "fx_px"): (*NO_LENGTHS, 0, -1),
    ("intrinsics", "width_px"): (0, *NO_NUMBERS),
    ("intrinsics", "distortion"): ([1, 2], ["a"] * 5, 0, [float("nan")] * 5),
    ("intrinsics", "distortion_model"): ("../x", 5),
    ("intrinsics", "K"): ([], [[1, 2, 3]], None, [[5, 0, 7], [0, 5, 7], [0, 0, 1]]),
    ("images",): ({}, [], None, {"../rgb": 1}),
    ("images", "rgb"): ({}, [], None),
    ("images", "rgb", "offset"): (-1, 10**18, "0", None),
    ("images", "rgb", "size"): (-1, 10**18, "0", None),
    ("images", "rgb", "shape"): ([], [1], [12, 10**9, 3], [1, 2, 3, 4], "ab", [13, 16, 3]),
    ("images", "rgb", "sha256"): ("", "g" * 64, None),
    ("label_pixels",): ({"a": 1}, {"-1": 1}, {"1": -1}, {"70000": 1}, [], {"1": 10**30}),
    ("provenance",): ({}, [], None),
    ("provenance", "batch_seed"): (-1, "x", 10**80),
    ("config_sha256",): NO_HASHES,
    ("provenance", "config_sha256"): NO_HASHES,
    ("provenance", "metadata_json"): NO_OBJECTS,
    ("provenance", "previous_poses_json"): NO_OBJECTS,
    ("provenance", "motion_json"): NO_OBJECTS,
    ("provenance", "exposures_json"): (
        *NO_OBJECTS,
        *('{"camera": "x"}', '{"camera": NaN}', '{"camera": true}', '{"camera": [1]}'),
    ),
    ("rig_pose",): ({}, [], None),
    ("rig_pose", "position_m"): ([1, 2], [float("nan")] * 3, None),
    ("software",): ([], {"a": 1}, {"a": "b\0"}),
    ("worker",): (1, None, "a\nb"),
    ("sun_elevation_deg",): (1e9, "x", float("nan")),
}
"""Values that no record may have, by the path of a field."""

CASES = [(path, value) for path, values in FIELDS.items() for value in values]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("written") / "set"
    write_dataset(folder, {0: "train"}, views=2)
    return folder


@pytest.fixture
def foreign(written: Path, tmp_path: Path) -> Path:
    """A data set that a test may change."""
    folder = tmp_path / "in/set"
    shutil.copytree(written, folder)
    return folder


def change_line(dataset: Path, path: tuple[str | int, ...], value: Any, line: int = 0) -> None:
    file = dataset / MANIFEST
    lines = file.read_text().splitlines()
    record = json.loads(lines[line])
    put(*path)(record, value)
    lines[line] = json.dumps(record)
    file.write_text("".join(f"{each}\n" for each in lines))


def refusal(dataset: Path) -> str:
    """Return why the records of a data set are refused; nothing if they are not."""
    try:
        list(open_dataset(dataset).records)
    except InvalidInputError as error:
        return str(error)
    return ""


def files_below(folder: Path) -> set[Path]:
    return set(folder.rglob("*"))


def test_every_field_of_a_line_is_refused_with_file_line_field_and_value(foreign: Path) -> None:
    sound = (foreign / MANIFEST).read_text()
    accepted = []
    for path, value in CASES:
        (foreign / MANIFEST).write_text(sound)
        change_line(foreign, path, value, line=1)
        told = refusal(foreign)
        if not re.match(rf"{MANIFEST}:2: .*{path[0]}", told) or len(told) > 1000:
            accepted.append((path, value, told))
    assert not accepted


@pytest.mark.parametrize("name", format_names())
def test_no_export_writes_outside_of_its_folder(name: str, foreign: Path, tmp_path: Path) -> None:
    sound = (foreign / MANIFEST).read_text()
    before = files_below(tmp_path)
    for field in (("frame_id",), ("sensor",), ("split",), ("images", "rgb", "file")):
        for value in NO_NAMES:
            (foreign / MANIFEST).write_text(sound)
            for line in range(2):
                change_line(foreign, field, value, line)
            with pytest.raises(InvalidInputError):
                export_dataset(open_dataset(foreign), name, tmp_path / "out")
    assert files_below(tmp_path) == before


@pytest.mark.parametrize("name", sorted({*format_names()} - {"hdf5", "webdataset"}))
def test_two_frames_with_one_name_are_refused(name: str, foreign: Path, tmp_path: Path) -> None:
    line = (foreign / MANIFEST).read_text().splitlines(keepends=True)[0]
    (foreign / MANIFEST).write_text(line * 2)
    before = files_below(tmp_path)
    with pytest.raises(InvalidInputError):
        export_dataset(open_dataset(foreign), name, tmp_path / "out")
    assert files_below(tmp_path) == before


def test_files_are_those_of_the_manifest(foreign: Path, tmp_path: Path) -> None:
    """The picture of one view where that of another is expected: both can be read."""
    first = json.loads((foreign / MANIFEST).read_text().splitlines()[0])["images"]["rgb"]
    for key in ("offset", "size"):
        change_line(foreign, ("images", "rgb", key), first[key], line=1)
    with pytest.raises(InvalidInputError, match=r"rgb\.png: received 'bytes with the hash"):
        export_dataset(open_dataset(foreign), "tum", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_link_among_the_exports_is_not_followed(foreign: Path, tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.mkdir()
    (foreign / "exports").symlink_to(victim)
    done = oaisys_here("dataset", "export", foreign, "--format", "coco")
    assert done.returncode == 2, done.stderr
    assert "it is a link" in done.stderr
    assert not list(victim.iterdir())


HEADS: dict[str, tuple[Any, ...]] = {
    "worlds": NO_NUMBERS,
    "views": NO_NUMBERS,
    "seed": (-1, 10**80, "1"),
    "splits": ({}, {"../x": 0.5}, {"train": 2}, {"train": "1"}, []),
    "config": ([], None, {"sensors": []}),
    "version": (2, "1", None),
    "software": ({"a": 1}, []),
}


def test_every_field_of_the_head_is_refused(foreign: Path) -> None:
    sound = json.loads((foreign / HEAD).read_text())
    for field, values in HEADS.items():
        for value in values:
            (foreign / HEAD).write_text(json.dumps({**sound, field: value}))
            with pytest.raises(InvalidInputError, match=rf"{HEAD}: .*{field}"):
                open_dataset(foreign)


TEXTS = {
    "digits": '{"seed": ' + "7" * 100_000 + "}",
    "nested": "[" * 10_000,
    "closed": "[" * 10_000 + "]" * 10_000,
    "objects": '{"a":' * 10_000 + "1" + "}" * 10_000,
    "no JSON": "{",
    "bytes": "\udcff\udcfe",
    "number": "7",
    "empty": "{}",
}


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize("file", [HEAD, MANIFEST])
def test_texts_that_no_parser_takes_are_refused(kind: str, file: str, foreign: Path) -> None:
    text = TEXTS[kind].encode("utf-8", "surrogateescape")
    (foreign / file).write_bytes(text + b"\n")
    with pytest.raises(InvalidInputError, match=file) as raised:
        open_dataset(foreign)
    assert len(str(raised.value)) < 1000


@pytest.mark.parametrize(
    "command",
    [
        ("check",),
        ("export", "--format", "coco"),
        ("repeat", "000000_0001_camera"),
        ("describe",),
    ],
    ids=lambda command: command[0],
)
def test_each_command_says_what_is_wrong_without_a_traceback(
    command: tuple[str, ...], foreign: Path
) -> None:
    change_line(foreign, ("images", "rgb", "size"), 10**12, line=1)
    change_line(foreign, ("split",), "../../split", line=1)
    name, *others = command
    done = oaisys_here("dataset", name, foreign, *others)
    assert "Traceback" not in done.stderr
    told = done.stderr + done.stdout
    assert f"{MANIFEST}:2: split: received '../../split'" in told
    assert done.returncode == (1 if name == "check" else 2)


def test_a_size_beyond_the_file_takes_no_memory(foreign: Path) -> None:
    change_line(foreign, ("images", "rgb", "size"), MAX_FILE_BYTES)
    dataset = open_dataset(foreign)
    with little_memory(), pytest.raises(InvalidInputError):
        dataset[0]


def test_lines_of_scans_are_checked_likewise(tmp_path: Path) -> None:
    render_dataset(tmp_path, {0: "train"}, 1, SCANNED)
    file = tmp_path / "shards/world_000000.scans.jsonl"
    sound = json.loads(file.read_text().splitlines()[0])
    for path, value in (
        (("scan_id",), "/tmp/x"),
        (("sensor",), "../x"),
        (("points", "file"), "../x"),
        (("points", "count"), -1),
        (("points", "fields"), ["x", "../y", "z"]),
        (("T_map_lidar",), [[float("inf")] * 4] * 4),
    ):
        record = json.loads(json.dumps(sound))
        put(*path)(record, value)
        file.write_text(json.dumps(record) + "\n")
        with pytest.raises(InvalidInputError, match=r"scans\.jsonl:1: "):
            list(open_dataset(tmp_path).scans)


@pytest.mark.parametrize("text", NO_NAMES)
def test_what_is_no_name_makes_no_path(text: str) -> None:
    assert not is_name(text)
    with pytest.raises(InvalidInputError, match="a name of at most 200 bytes"):
        path_inside(Path("out"), "a", text, "b")


def test_names_of_files_stay_as_they_are() -> None:
    for name in ("000012_0003_camera.semantic_0.png", "train-000000.tar", "caméra", "1.5+2"):
        assert path_inside(Path("out"), name) == Path("out", name)


def test_samples_of_somebody_else_are_refused_likewise(tmp_path: Path) -> None:
    config = tmp_path / "world.yaml"
    camera = "{width_px: 8, height_px: 6, modalities: [depth]}"
    config.write_text(
        "backend: analytic\nstage: {extent_m: 10, resolution_px: 33}\n"
        f"sensors: {{cameras: [{camera}]}}\n"
        "materials: {texture_size_px: 32, mask: {size_px: 32, relief: 0}}\nassets: {rocks: []}\n"
    )
    out = tmp_path / "out"
    assert oaisys_here("render", "--config", config, "--out", out).returncode == 0
    file = out / "batch_0001/meta_data/sample_data/0001.json"
    sound = file.read_text()
    for path, value in (
        (("sensors", "camera", "images", "depth"), "../../../outside.exr"),
        (("sensors", "camera", "images", "depth"), "/etc/passwd"),
        (("sensors", "camera", "T_map_camera"), [[0]]),
        (("sensors", "camera", "intrinsics"), {}),
        (("rig_pose", "position_m"), [float("nan")] * 3),
        (("provenance", "batch_seed"), -1),
        (("sensors",), []),
    ):
        record = json.loads(sound)
        put(*path)(record, value)
        file.write_text(json.dumps(record))
        with pytest.raises(InvalidInputError):
            list(read_samples(out / "batch_0001"))
    done = oaisys_here("repeat", out)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    for text in TEXTS.values():
        file.write_bytes(text.encode("utf-8", "surrogateescape"))
        with pytest.raises(InvalidInputError):
            list(read_samples(out / "batch_0001"))
    file.write_text(sound)
    (out / "state.json").write_text("[]")
    done = oaisys_here("render", "--config", config, "--out", out, "--samples", 2, "--resume")
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("worlds", [0, 1])
def test_worlds_beyond_those_of_the_head_are_refused(tmp_path: Path, worlds: int) -> None:
    folder = tmp_path / "set"
    write_dataset(folder, {0: "train", 1: "val"}, views=1)
    assert open_dataset(folder).worlds == (0, 1)
    head = json.loads((folder / HEAD).read_text())
    (folder / HEAD).write_text(json.dumps({**head, "worlds": worlds}))
    with pytest.raises(InvalidInputError, match="2 or more, as there is world 1") as error:
        open_dataset(folder)
    assert error.value.field == "dataset.json: worlds"
    assert error.value.received == worlds


SPARSE_BYTES = 1 << 28
"""Size of a file that takes no room on a disk; of one that is read as a whole, more."""

LITTLE_BYTES = SPARSE_BYTES / 4


@contextmanager
def little_memory() -> Iterator[None]:
    tracemalloc.start()
    yield
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < LITTLE_BYTES


def findings_of(dataset: Path) -> str:
    """Return what a check finds in the first world."""
    place = open_place(dataset)
    parts, _ = part_plans(read_head(place))
    with little_memory():
        return str(check_shard(place, parts[0], 0).findings)


def test_what_follows_a_tar_file_takes_no_memory(foreign: Path) -> None:
    os.truncate(foreign / tar_name(0), SPARSE_BYTES)
    assert "bytes follow the end of the tar file" in findings_of(foreign)


@pytest.mark.parametrize("kind", [tarfile.XHDTYPE, tarfile.GNUTYPE_LONGNAME])
def test_a_head_of_a_member_takes_no_memory(kind: bytes, foreign: Path) -> None:
    member = tarfile.TarInfo("head")
    member.type, member.size = kind, SPARSE_BYTES
    tar = foreign / tar_name(0)
    tar.write_bytes(member.tobuf(tarfile.USTAR_FORMAT))
    os.truncate(tar, 2 * SPARSE_BYTES)
    assert f"a member's head has {SPARSE_BYTES} bytes" in findings_of(foreign)


def test_images_far_from_each_other_take_no_memory(foreign: Path) -> None:
    os.truncate(foreign / tar_name(0), SPARSE_BYTES)
    change_line(foreign, ("images", "rgb", "offset"), SPARSE_BYTES - 1000)
    with little_memory(), pytest.raises(InvalidInputError, match="files beside each other"):
        open_dataset(foreign)[0]


def test_a_file_that_is_read_as_a_whole_is_bounded(foreign: Path) -> None:
    change_line(foreign, ("images", "rgb", "size"), MAX_FILE_BYTES + 1)
    assert f"a number of at most {MAX_FILE_BYTES}" in refusal(foreign)
    os.truncate(foreign / MANIFEST, MAX_WHOLE_BYTES + 1)
    with little_memory():
        assert f"more than {MAX_WHOLE_BYTES}" in refusal(foreign)


def test_a_split_that_the_head_has_not_is_refused(foreign: Path, tmp_path: Path) -> None:
    for line in range(2):
        change_line(foreign, ("split",), "other", line)
    told = f"{MANIFEST}:1: split: received 'other', expected one of train, val, as {HEAD} says"
    assert told in refusal(foreign)
    done = oaisys_here("dataset", "export", foreign, "--format", "coco", "--out", tmp_path / "out")
    assert told in done.stderr
    assert done.returncode == 2
