"""Each writer of a file has a temporary one of its own, which nobody else can replace."""

from __future__ import annotations

import fcntl
import os
import signal
import stat
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from oaisys_core.files.temporary_files import WRITERS
from oaisys_core.files.whole_files import whole_file, write_whole_bytes
from oaisys_core.system.ending.leftovers import Leftovers

WRITE_AND_DIE = """
import os, signal, sys
from pathlib import Path
from oaisys_core.files.whole_files import whole_file
with whole_file(Path(sys.argv[1])) as part:
    part.write_bytes(b"half")
    os.kill(os.getpid(), signal.SIGKILL)
"""
SIZE = 100_000


def test_what_others_put_in_the_place_of_a_temporary_file_is_not_written_to(tmp_path: Path) -> None:
    """Whoever may write to a folder may rename all that is in it, and put links there."""
    victim, path, moved = tmp_path / "victim", tmp_path / "x.bin", tmp_path / "moved"
    victim.write_bytes(b"precious")
    with whole_file(path) as part:
        hidden = next(tmp_path.glob(".*part*"))
        hidden.rename(moved)
        if moved.is_dir():
            hidden.mkdir()
            (hidden / part.name).symlink_to(victim)
        else:
            hidden.symlink_to(victim)
        part.write_bytes(b"new")
    assert victim.read_bytes() == b"precious"
    assert path.read_bytes() == b"new"
    assert not path.is_symlink()


def test_names_that_others_have_taken_are_not_used(tmp_path: Path) -> None:
    victim, path = tmp_path / "victim", tmp_path / "x.bin"
    victim.mkdir()
    taken = [tmp_path / name for name in (".x.bin.part", ".x.bin.1.part", ".x.bin.2.part")]
    taken[0].symlink_to(victim)
    taken[1].mkdir()
    (taken[1] / "kept").touch()
    os.mkfifo(taken[2])
    (tmp_path / ".x.bin.3.part").write_bytes(b"precious")
    before = sorted(tmp_path.rglob("*"))
    assert len(taken) + 1 == WRITERS
    write_whole_bytes(path, b"new")
    assert path.read_bytes() == b"new"
    assert sorted(tmp_path.rglob("*")) == sorted([*before, path])
    assert not list(victim.iterdir())


def test_the_last_of_two_writers_wins(tmp_path: Path) -> None:
    """The second removed the first's temporary file: FileNotFoundError, or half a file."""
    path = tmp_path / "x.bin"
    with whole_file(path) as first:
        first.write_bytes(b"first")
        with whole_file(path) as second:
            second.write_bytes(b"second")
        assert path.read_bytes() == b"second"
    assert path.read_bytes() == b"first"
    assert list(tmp_path.iterdir()) == [path]


def test_many_writers_of_one_file_leave_it_whole(tmp_path: Path) -> None:
    path = tmp_path / "x.bin"
    write_whole_bytes(path, bytes(SIZE))

    def write_again_and_again(number: int) -> None:
        for _ in range(20):
            write_whole_bytes(path, bytes([number]) * SIZE)
            found = path.read_bytes()
            assert len(found) == SIZE
            assert len(set(found)) == 1

    with ThreadPoolExecutor(2 * WRITERS) as threads:
        list(threads.map(write_again_and_again, range(2 * WRITERS)))
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_killed_writer_left_is_removed_but_not_what_a_living_one_has(tmp_path: Path) -> None:
    path = tmp_path / "x.bin"
    with whole_file(path) as living:
        living.write_bytes(b"living")
        own = set(tmp_path.iterdir())
        done = subprocess.run([sys.executable, "-c", WRITE_AND_DIE, str(path)], check=False)
        assert done.returncode == -signal.SIGKILL
        assert len(set(tmp_path.iterdir()) - own) == 1
        write_whole_bytes(path, b"next")
        assert set(tmp_path.iterdir()) == {*own, path}
    assert path.read_bytes() == b"living"
    assert list(tmp_path.iterdir()) == [path]


def test_a_command_that_ends_removes_no_folder_that_another_has_locked(tmp_path: Path) -> None:
    record = Leftovers()
    living, dead = tmp_path / "living", tmp_path / "dead"
    for folder in (living, dead):
        folder.mkdir()
        record.add(folder)
    lock = os.open(living, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    record.remove()
    os.close(lock)
    assert list(tmp_path.iterdir()) == [living]


@pytest.mark.parametrize("name", ["a.tar.gz", "noend", "x" * 240 + ".bin"])
def test_a_temporary_file_has_the_suffix_and_the_mode_of_any_new_file(
    tmp_path: Path, name: str
) -> None:
    path = tmp_path / name
    before = os.umask(0o027)
    try:
        with whole_file(path) as part, whole_file(path) as other:
            assert part.suffix == other.suffix == path.suffix
            folders = list(tmp_path.iterdir())
            assert [stat.S_IMODE(folder.stat().st_mode) for folder in folders] == [0o700, 0o700]
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert list(tmp_path.iterdir()) == [path]


def test_errors_name_the_file_that_was_to_be_written(tmp_path: Path) -> None:
    path = tmp_path / "x.bin"
    with pytest.raises(IsADirectoryError) as error, whole_file(path):
        path.mkdir()
    assert error.value.filename == str(path)
    assert list(tmp_path.iterdir()) == [path]


def test_an_error_names_the_file_that_was_asked_for(tmp_path: Path) -> None:
    for target in (Path("/proc/x.ply"), tmp_path / "missing" / "x.ply"):
        with pytest.raises(OSError, match="No such file") as caught, whole_file(target):
            pass
        assert caught.value.filename == str(target)


@pytest.mark.parametrize("name", ["x" * 251 + ".ply", "\N{SNOWMAN}" * 83 + "x.ply"])
def test_a_file_of_the_longest_name_can_be_written(tmp_path: Path, name: str) -> None:
    with whole_file(tmp_path / name) as part:
        assert part.suffix == ".ply"
        part.write_text("whole")
    assert [(each.name, each.read_text()) for each in tmp_path.iterdir()] == [(name, "whole")]
