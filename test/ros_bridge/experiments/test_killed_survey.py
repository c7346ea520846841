"""A survey that is killed leaves no process behind, and a bag that is finished."""

from __future__ import annotations

import os
import subprocess
import sys
import uuid
from pathlib import Path

import pytest
import yaml
from leak_check import MARK, marked_processes
from mcap.reader import make_reader
from served_simulator import MOUNDS
from waiting import PATIENCE_S, START_PATIENCE_S, wait_until

pytestmark = pytest.mark.ros


@pytest.mark.long
def test_what_a_killed_survey_has_started_ends_and_finishes_its_bag(tmp_path: Path) -> None:
    world = tmp_path / "world.yaml"
    world.write_text(yaml.safe_dump(MOUNDS))
    out, mark = tmp_path / "out", str(uuid.uuid4())
    command = [sys.executable, "-m", "oaisys_core", "survey", "--config", str(world)]
    command += ["--out", str(out), "--views", "30", "--size", "160x120"]
    (folder := tmp_path / "tmp").mkdir()
    with (tmp_path / "log").open("w") as log:
        survey = subprocess.Popen(
            command,
            stdout=log,
            stderr=log,
            env={**os.environ, MARK: mark, "TMPDIR": str(folder)},
            start_new_session=True,
        )
    bag = out / "bag"
    wait_until(
        lambda: any(each.stat().st_size > 200_000 for each in bag.glob("*.mcap")),
        START_PATIENCE_S,
        process=survey,
        explain=(tmp_path / "log").read_text,
    )
    started = marked_processes(mark)
    assert len(started) >= 6  # survey, server, worker, bridge, mapper, recorder
    survey.kill()
    survey.wait(PATIENCE_S)

    wait_until(lambda: not marked_processes(mark), explain=lambda: marked_processes(mark))
    assert not list(folder.glob("oaisys-run-*"))  # the server's, with its socket
    assert (bag / "metadata.yaml").is_file()
    with next(bag.glob("*.mcap")).open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count > 0
    for text in (each.read_text() for each in (out / "logs").glob("*.log")):
        assert "Traceback" not in text
