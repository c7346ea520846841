"""Files under names that others can foresee: no link of theirs is followed, nobody else reads."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from oaisys_core.system.private_files import hide_file, open_private


def test_a_file_is_made_or_opened_for_this_user_alone(tmp_path: Path) -> None:
    path = tmp_path / "file"
    for text in (b"one", b"two"):
        descriptor = open_private(path, os.O_WRONLY | os.O_APPEND)
        os.write(descriptor, text)
        os.close(descriptor)
        assert path.stat().st_mode & 0o777 == 0o600
        path.chmod(0o644)
    assert path.read_bytes() == b"onetwo"


def test_links_and_what_is_no_file_are_refused(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("kept")
    (tmp_path / "link").symlink_to(victim)
    os.mkfifo(tmp_path / "pipe")
    for name in ("link", "pipe"):
        with pytest.raises(OSError, match=name):
            open_private(tmp_path / name, os.O_RDWR)
    assert victim.read_text() == "kept"


def test_a_file_is_hidden_where_there_is_one(tmp_path: Path) -> None:
    path, link = tmp_path / "file", tmp_path / "link"
    path.touch(mode=0o644)
    link.symlink_to(path)
    for other in (link, tmp_path / "none"):
        with pytest.raises(OSError, match=other.name):
            hide_file(other)
    assert path.stat().st_mode & 0o777 == 0o644
    hide_file(path)
    assert path.stat().st_mode & 0o777 == 0o600
    assert not (tmp_path / "none").exists()
