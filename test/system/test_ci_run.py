"""What `.ci/run` tells of lint and of the tests, with a `make` that stands in for ours."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest
from repository import REPOSITORY
from waiting import wait_until

MAKE = """#!/bin/sh
case $1 in
    lint) {lint} ;;
    test-all) {tests} ;;
esac
"""
TESTS_PASS = "echo '== 3 passed =='"


def prepare(folder: Path, lint: str, tests: str) -> tuple[list[str], dict[str, str]]:
    """Return the command of a copy of `.ci/run`, and the environment with a `make` beside it."""
    run = folder / ".ci" / "run"
    run.parent.mkdir()
    shutil.copy(REPOSITORY / ".ci" / "run", run)
    make = folder / "make"
    make.write_text(MAKE.format(lint=lint, tests=tests), encoding="utf-8")
    make.chmod(0o755)
    return [str(run)], {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}"}


@pytest.mark.parametrize(
    ("lint", "tests", "told"),
    [
        ("echo 'no faults'", TESTS_PASS, "passed"),
        ("echo 'x.py: a fault' >&2; exit 2", TESTS_PASS, "tests passed, lint failed"),
        ("sleep 1; exit 1", TESTS_PASS, "tests passed, lint failed"),
        ("true", "echo '== 1 failed =='; exit 2", "tests failed, lint passed"),
        ("exit 2", "exit 2", "tests failed, lint failed"),
    ],
)
def test_it_passes_where_lint_and_tests_do(
    tmp_path: Path, lint: str, tests: str, told: str
) -> None:
    command, environment = prepare(tmp_path, lint, tests)
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    is_passed = told == "passed"
    assert result.returncode == (0 if is_passed else 1), result.stderr
    last = (result.stdout if is_passed else result.stderr).splitlines()[-1]
    assert last.startswith(f"ci: {told} after ")


def test_the_output_of_lint_is_one_piece_before_the_tests_close(tmp_path: Path) -> None:
    lint = "echo first; echo second >&2; exit 1"
    command, environment = prepare(tmp_path, lint, f"echo .; sleep 2; {TESTS_PASS}")
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    lines = result.stdout.splitlines()
    start = lines.index("first")
    assert lines[start + 1] == "second"
    assert lines[start + 2].startswith("ci: lint failed after ")
    assert lines[-1] == "== 3 passed =="


def test_lint_ends_with_a_run_that_is_ended(tmp_path: Path) -> None:
    lint = f"touch '{tmp_path}/begun'; sleep 20; touch '{tmp_path}/went_on'"
    command, environment = prepare(tmp_path, lint, "sleep 1; exit 1")
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as run:
        wait_until((tmp_path / "begun").exists)
        run.send_signal(signal.SIGTERM)
        # Its pipe is closed once the last of its programs has ended.
        run.communicate(timeout=15)
    assert not (tmp_path / "went_on").exists()
