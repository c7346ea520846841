"""The file that keeps what workers print."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from oaisys_grpc.server.supervision.worker_log import WorkerLog

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
