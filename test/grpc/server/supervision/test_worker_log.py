"""The file that keeps what workers print."""

from __future__ import annotations

import logging
import os
from pathlib import Path

import pytest

from oaisys_grpc.server.supervision.worker_log import WorkerLog, state_folder

ADDRESS = "127.0.0.1:50051"
LOG = "worker-127.0.0.1-50051.log"


def test_a_worker_s_log_follows_no_link_and_is_read_by_its_user_alone(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """It appended to the file of whoever ran the server, in a folder that others may write to."""
    victim = tmp_path / "victim"
    victim.write_text("kept")
    (tmp_path / LOG).symlink_to(victim)
    log = WorkerLog()
    with caplog.at_level(logging.WARNING):
        log.open(tmp_path, ADDRESS)
    log.write(1, "a line")
    log.close()
    assert victim.read_text() == "kept"
    assert log.path is None
    assert "not kept" in caplog.text

    log.open(tmp_path / "state", ADDRESS)
    log.write(1, "a line")
    log.close()
    assert "a line" in (tmp_path / "state" / LOG).read_text()
    assert (tmp_path / "state" / LOG).stat().st_mode & 0o777 == 0o600


def test_a_user_without_a_home_is_told_that_nothing_is_kept(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The server ended with a traceback, in containers whose user is just a number."""
    monkeypatch.delenv("HOME")
    monkeypatch.delenv("XDG_STATE_HOME", raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 2_000_000_123)
    with caplog.at_level(logging.WARNING):
        assert state_folder() is None
    assert "--worker-log" in caplog.text
    monkeypatch.setenv("XDG_STATE_HOME", "/elsewhere")
    assert state_folder() == Path("/elsewhere/oaisys")
