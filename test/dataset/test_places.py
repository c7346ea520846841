"""Places hold objects that are whole or absent."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, cast

import pytest
from small_datasets import render_dataset
from synthetic_datasets import write_dataset
from waiting import PATIENCE_S

from oaisys_core.errors import InvalidInputError, NotFoundError, RenderError
from oaisys_dataset import open_dataset
from oaisys_dataset.check import check_dataset
from oaisys_dataset.places import StoragePlace, open_place
from oaisys_dataset.places.remote import PIECE_BYTES, RemotePlace


@pytest.fixture(params=["folder", "file", "memory"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> StoragePlace:
    kinds = {"folder": str(tmp_path / "set"), "file": f"file://{tmp_path}/set"}
    return open_place(kinds.get(request.param, f"memory://{tmp_path.name}/set"))


def exercise(place: StoragePlace) -> None:
    """Do with a place all that data sets do."""
    assert place.names("shards") == []
    assert not place.exists("dataset.json")
    assert place.is_empty()
    with pytest.raises(NotFoundError, match="shards/a"):
        place.read("shards/a")
    place.write("dataset.json", b"head")
    place.write("shards/b", b"0123456789")
    with place.writing("shards/a") as path:
        path.write_bytes(b"a" * 1000)
    with place.streaming("shards/c") as file:
        for byte in b"xyz":
            file.write(bytes([byte]) * PIECE_BYTES)
        assert file.tell() == 3 * PIECE_BYTES
    assert place.read("shards/c", 2 * PIECE_BYTES - 1, 2) == b"yz"
    place.delete("shards/c")
    assert place.names("shards") == ["shards/a", "shards/b"]
    assert place.exists("shards/a")
    assert place.read("dataset.json") == b"head"
    assert place.read("shards/b", 2, 3) == b"234"
    assert place.read("shards/b", 0, 4) == b"0123"
    assert place.read("shards/b", 8) == b"89"
    assert place.size("shards/a") == 1000
    place.write("shards/b", b"new")
    assert place.read("shards/b") == b"new"
    place.delete("shards/b")
    place.delete("shards/b")
    assert place.names("shards") == ["shards/a"]
    assert not place.is_empty()
    place.clear()
    assert place.is_empty()
    assert place.names("shards") == []
    place.clear()


def test_objects_are_written_listed_read_and_deleted(place: StoragePlace) -> None:
    exercise(place)


def test_an_object_stays_as_it_was_if_writing_fails(place: StoragePlace) -> None:
    place.write("shards/a", b"before")

    def interrupted() -> None:
        with place.writing("shards/a") as path:
            path.write_bytes(b"half")
            raise KeyError

    with pytest.raises(KeyError):
        interrupted()
    assert place.read("shards/a") == b"before"
    assert place.names("shards") == ["shards/a"]


@pytest.mark.parametrize("kind", ["folder", "memory"])
def test_an_object_that_is_streamed_is_whole_or_absent(tmp_path: Path, kind: str) -> None:
    place = open_place(tmp_path if kind == "folder" else f"memory://{tmp_path.name}/streams")

    def interrupted() -> None:
        with place.streaming("shards/a") as file:
            file.write(b"half" * PIECE_BYTES)
            raise KeyError

    with pytest.raises(KeyError):
        interrupted()
    assert place.names("shards") == []


class Store:
    """A file system with one file, which takes bytes when it is allowed to.

    Attributes:
        taken: The bytes.
        is_allowed: Set when it may take bytes.
        deleted: The files that were deleted.
        error: What goes wrong when it takes bytes.
    """

    def __init__(self) -> None:
        self.taken = b""
        self.is_allowed = threading.Event()
        self.deleted: list[str] = []
        self.error: OSError | None = None

    def makedirs(self, path: str, exist_ok: bool) -> None: ...

    def open(self, path: str, mode: str) -> Store:
        return self

    def write(self, data: bytes) -> None:
        assert self.is_allowed.wait(PATIENCE_S)
        if self.error is not None:
            raise self.error
        self.taken += data

    def close(self) -> None: ...

    def rm_file(self, path: str) -> None:
        self.deleted.append(path)


def test_an_upload_goes_on_while_more_is_written() -> None:
    store = Store()
    first, rest = b"a" * PIECE_BYTES, b"b" * (PIECE_BYTES - 1)
    with RemotePlace("store://", cast("Any", store), "root").streaming("a") as file:
        file.write(first)  # returns, though the store takes nothing yet
        file.write(rest)
        assert store.taken == b""
        store.is_allowed.set()
    assert store.taken == first + rest


@pytest.mark.parametrize("pieces", [0, 1, 2, 3])
def test_an_upload_that_fails_is_an_error_wherever_it_is_noticed(pieces: int) -> None:
    store = Store()
    store.is_allowed.set()
    store.error = OSError("the store is full")

    def upload() -> None:
        with RemotePlace("store://", cast("Any", store), "root").streaming("a") as file:
            file.write(b"c")
            for _ in range(pieces):
                file.write(b"d" * PIECE_BYTES)

    with pytest.raises(RenderError, match="store:///a: could not be written: the store is full"):
        upload()
    assert store.deleted == ["root/a"]


def test_a_full_disk_is_an_error_and_leaves_the_object(tmp_path: Path) -> None:
    place = open_place(tmp_path)
    place.write("shards/a", b"before")

    def write_to_full_disk() -> None:
        with place.writing("shards/a") as path:
            path.symlink_to("/dev/full")
            path.write_bytes(b"x")

    with pytest.raises(RenderError, match="No space left"):
        write_to_full_disk()
    assert place.read("shards/a") == b"before"


def test_parts_of_a_killed_process_are_hidden_and_deleted(tmp_path: Path) -> None:
    place = open_place(tmp_path)
    place.write("shards/a", b"a")
    code = (
        "import os, sys; from oaisys_dataset.places import open_place\n"
        "with open_place(sys.argv[1]).writing('shards/b') as path:\n"
        "    path.write_bytes(b'half'); os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    assert len(list((tmp_path / "shards").iterdir())) == 2
    assert place.names("shards") == ["shards/a"]
    assert place.delete_parts() == 1
    assert [path.name for path in (tmp_path / "shards").iterdir()] == ["a"]


def test_folders_of_writers_of_other_files_in_a_data_set_are_left_alone(tmp_path: Path) -> None:
    """`delete_parts` ended with IsADirectoryError, for instance after a killed export."""
    folder = tmp_path / ".check.json.part"
    folder.mkdir()
    assert open_place(tmp_path).delete_parts() == 0
    assert folder.is_dir()


@pytest.mark.parametrize("name", ["dataset.json", "shards/world_000000.tar"])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_a_pipe_or_device_in_a_folder_is_refused(tmp_path: Path, name: str, kind: str) -> None:
    write_dataset(tmp_path / "set", {0: "train"})
    path = tmp_path / "set" / name
    path.unlink()
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    command = [sys.executable, "-P", "-m", "oaisys_core", "dataset", "export", "--format", "coco"]
    done = subprocess.run(
        [*command, "--out", str(tmp_path / "out"), str(tmp_path / "set")],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 2
    assert f"{name}', expected a readable file (it is not a regular file)" in done.stderr
    assert not (tmp_path / "out").exists()


def test_an_unknown_kind_of_url_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="nowhere"):
        open_place("nowhere://bucket/set")


def test_an_s3_server_holds_data_sets(bucket: str) -> None:
    exercise(open_place(f"{bucket}/objects"))
    written = write_dataset(f"{bucket}/set", {0: "train", 7: "val"})
    dataset = open_dataset(f"{bucket}/set")
    assert dataset.worlds == (0, 7)
    assert dataset.legend(7).labels[3] == "of world 7"
    for sample in dataset.stream(["rgb"]):
        assert (sample.arrays["rgb"] == written[sample.record.frame_id]["rgb"]).all()
    with pytest.raises(InvalidInputError, match=r"dataset\.json"):
        open_dataset(f"{bucket}/nothing")


@pytest.mark.long
def test_a_data_set_on_an_s3_server_is_checked(bucket: str) -> None:
    render_dataset(f"{bucket}/set", {0: "train"}, views=2)
    report = check_dataset(f"{bucket}/set")
    assert report.findings == ()
    assert report.points
    place = open_place(f"{bucket}/set")
    tar = bytearray(place.read("shards/world_000000.tar"))
    tar[5000] ^= 1
    place.write("shards/world_000000.tar", bytes(tar))
    report = check_dataset(f"{bucket}/set", worlds_rebuilt=0)
    assert {finding.check for finding in report.findings} >= {"hash"}


@pytest.mark.parametrize("url", ["s3://", "file://", "memory://", "s3:///"])
def test_a_url_of_no_place_is_refused(url: str) -> None:
    with pytest.raises(InvalidInputError, match="place: received"):
        open_place(url)
