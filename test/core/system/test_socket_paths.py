"""Where sockets are: paths of at most 107 bytes, wherever temporary files are."""

from __future__ import annotations

import os
import socket
import stat
import tempfile
from pathlib import Path

import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_core.system.socket_paths import MAX_PATH_BYTES, fits, socket_parent
from oaisys_dataset.rendering.embedded_ray import FOLDER, INNER, LONGEST_SOCKET_BYTES

BELOW_BYTES = len(f"/{FOLDER}12345678/{INNER}") + LONGEST_SOCKET_BYTES


@pytest.mark.parametrize("letters", range(10, 111))
def test_for_every_length_of_tmpdir_a_socket_fits(
    letters: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parent = Path("/tmp", "d" * (letters - len("/tmp/")))
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr("oaisys_core.system.socket_paths._is_usable", lambda _: True)
    monkeypatch.setattr(tempfile, "tempdir", str(parent))
    found = socket_parent(BELOW_BYTES)
    assert len(str(found)) + BELOW_BYTES <= MAX_PATH_BYTES
    assert (found == parent) == (letters + BELOW_BYTES <= MAX_PATH_BYTES)


def test_the_bound_is_the_kernel_s(tmp_path: Path) -> None:
    folder = Path(tempfile.mkdtemp(prefix="s", dir="/tmp"))
    try:
        longest = MAX_PATH_BYTES - len(f"{folder}/")
        for letters, is_taken in ((longest, True), (longest + 1, False)):
            path = folder / ("s" * letters)
            assert fits(path) == is_taken
            with socket.socket(socket.AF_UNIX) as server:
                if is_taken:
                    server.bind(str(path))
                    path.unlink()
                else:
                    with pytest.raises(OSError, match="too long"):
                        server.bind(str(path))
    finally:
        folder.rmdir()


def test_where_nothing_fits_the_sentence_says_how_long_tmpdir_may_be(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("oaisys_core.system.socket_paths._is_usable", lambda _: False)
    with pytest.raises(InvalidInputError, match=r"TMPDIR: .* a folder of at most \d+ bytes"):
        socket_parent(BELOW_BYTES)


def test_a_folder_whose_name_is_not_utf_8_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr("oaisys_core.system.socket_paths._is_usable", lambda _: True)
    monkeypatch.setattr(tempfile, "tempdir", os.fsdecode(b"/tmp/\xfe"))
    assert socket_parent(BELOW_BYTES) == Path("/tmp")


@pytest.mark.parametrize(
    "letters",
    [pytest.param(22, marks=pytest.mark.soak), pytest.param(35, marks=pytest.mark.long)],
)
def test_ray_starts_at_the_lengths_at_which_it_failed(
    letters: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    from oaisys_dataset.rendering.ray_session import ray_session
    from oaisys_dataset.rendering.ray_settings import RaySettings

    parent = Path(tempfile.mkdtemp(prefix="t", dir="/tmp"))
    folder = parent / ("d" * (letters - len(f"{parent}/")))
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))
    try:
        with ray_session(RaySettings(workers=1, memory_gb=0.5)) as session:
            assert session.folder is not None
            assert list(session.folder.glob("session_2*/sockets/plasma_store"))
            # Ray opens its own folder to every user, so it is in one that is not.
            assert stat.S_IMODE(session.folder.parent.stat().st_mode) == 0o700
        assert not session.folder.parent.exists()
        assert not list(folder.iterdir())
    finally:
        folder.rmdir()
        parent.rmdir()
