"""Standard streams that are closed or full."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from oaisys_core.system.standard_streams import printable

PROGRAM = [sys.executable, "-P", "-m", "oaisys_core"]


def run(arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command with redirections of the shell."""
    line = f'exec "$@" {arguments}'
    return subprocess.run(
        ["sh", "-c", line, "sh", *PROGRAM],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("closed")
    (folder / "world.yaml").write_text(
        "backend: analytic\nstage: {extent_m: 10, resolution_px: 33, surroundings: plain}\n"
        "materials: {texture_size_px: 16, mask: {size_px: 16, relief: 0}}\nassets: {rocks: []}\n"
        "sensors: {cameras: [{width_px: 8, height_px: 6, modalities: [depth]}]}\n"
    )
    done = run("render --config world.yaml --out out >&-", folder)  # it works with stdout closed
    assert (done.returncode, done.stderr.count("Traceback")) == (0, 0), done.stderr
    return folder


@pytest.mark.parametrize("closed", [">&- 2>&- <&-", pytest.param("<&-", marks=pytest.mark.long)])
def test_a_command_works_with_closed_streams(closed: str, rendered: Path) -> None:
    """`sys.stdout` was None: AttributeError, and files got the numbers of streams."""
    done = run(f"repeat out {closed}", rendered)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


def test_full_standard_output_is_a_sentence(rendered: Path) -> None:
    """It was exit code 120, with "Exception ignored in"."""
    done = run("repeat out >/dev/full", rendered)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "no space left" in done.stderr


def test_control_characters_of_others_do_not_reach_the_terminal() -> None:
    assert printable("a\x1b[2J\u202eb\nc\td") == "a\\x1b[2J\\u202eb\nc\td"
