"""Folders for output that cannot be made are refused by the option's name, with exit code 2."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from oaisys_core.errors import InvalidInputError, NotReadyError
from oaisys_core.files.folders import make_folder, own_folder, user_file, user_path


def test_a_folder_is_made_with_those_above_it(tmp_path: Path) -> None:
    assert make_folder(tmp_path / "a" / "b").is_dir()
    assert make_folder(tmp_path / "a" / "b").is_dir()


@pytest.mark.parametrize("name", ["file", "file/below", "/proc/none", "x" * 300])
def test_names_that_no_folder_can_have_are_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InvalidInputError, match=r"^out: received '.*', expected a folder"):
        make_folder(tmp_path / name)


def test_a_full_disk_is_no_fault_of_the_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def is_full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "mkdir", is_full)
    with pytest.raises(OSError, match="No space left"):
        make_folder(tmp_path / "a")


def test_a_folder_has_one_owner_at_a_time_and_keeps_no_file_of_it(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    with own_folder(folder) as owned:
        assert owned == folder
        another = own_folder(folder)
        with pytest.raises(NotReadyError, match=r"out: another command is writing to it"):
            another.__enter__()
        assert list(folder.iterdir()) == []
    with own_folder(folder):
        pass


def test_folders_that_a_failure_left_empty_are_removed(tmp_path: Path) -> None:
    (tmp_path / "before").mkdir()
    folder = tmp_path / "before" / "a" / "b"
    with pytest.raises(KeyError), own_folder(folder):
        raise KeyError
    assert list((tmp_path / "before").iterdir()) == []


def fail_with_a_file(folder: Path) -> None:
    (folder / "file").touch()
    raise KeyError


def test_folders_with_files_and_those_that_were_there_stay_after_a_failure(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    with pytest.raises(KeyError), own_folder(folder):
        fail_with_a_file(folder)
    assert (folder / "file").exists()
    (tmp_path / "empty").mkdir()
    with pytest.raises(KeyError), own_folder(tmp_path / "empty"):
        raise KeyError
    assert (tmp_path / "empty").is_dir()


@pytest.mark.parametrize(
    "text",
    [
        "x" * 256,
        "/" + "\N{SNOWMAN}" * 86,
        "a/" * 2048 + "a",
        "x" * 1_000_000,
        "a\0b",
        "\ud800" * 86,
    ],
)
def test_paths_that_no_file_can_have_are_refused_in_a_short_sentence(text: str) -> None:
    """One of 30 MB was answered by its whole length."""
    for read in (
        lambda: user_path(text, "truth_path"),
        lambda: user_file(text + ".ply", "truth_path", (".ply",)),
    ):
        with pytest.raises(InvalidInputError, match=r"^truth_path: received .*, expected") as error:
            read()
        assert len(str(error.value)) < 250


def test_the_longest_names_are_taken() -> None:
    for text in ("x" * 255, "a/" * 2047 + "a"):
        assert str(user_path(text, "out")) == text
