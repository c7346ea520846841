"""A newcomer does what the pages of Start say, block by block, and each command works.

`make setup` and `source` are left out: the environment of this run is in place of theirs, and
`test_setup.py` is about set-up. All else is run as it stands on the page.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
from repository import REPOSITORY

BLOCK = re.compile(r"```(bash|yaml)\n(.*?)```", re.DOTALL)
FILE = re.compile(r"Write this to `([\w/.]+)`")
SET_UP = ("make setup", "source .venv/")
TIMEOUT_S = 500.0


def do_as_the_page_says(page: str, folder: Path) -> list[str]:
    """Write the page's files, run its commands in order, and return the commands."""
    for name in ("config", "examples"):
        (folder / name).symlink_to(REPOSITORY / name)
    (folder / "out").mkdir()
    text = (REPOSITORY / "docs" / "start" / page).read_text(encoding="utf-8")
    done = []
    for match in BLOCK.finditer(text):
        language, content = match.groups()
        if language == "yaml":
            (folder / FILE.findall(text[: match.start()])[-1]).write_text(content, encoding="utf-8")
            continue
        for line in content.strip().splitlines():
            if line.startswith(SET_UP):
                continue
            ended = subprocess.run(
                ["bash", "-euc", line],
                cwd=folder,
                capture_output=True,
                text=True,
                timeout=TIMEOUT_S,
                check=False,
            )
            assert ended.returncode == 0, f"{line}\n{ended.stderr}"
            done.append(line)
    return done


@pytest.mark.soak
@pytest.mark.system
def test_without_ros(tmp_path: Path) -> None:
    done = do_as_the_page_says("no_ros.md", tmp_path)
    assert len(done) >= 7
    out = tmp_path / "out"
    assert len(list(out.glob("start/batch_0001/camera/*.png"))) == 3
    assert (out / "one_view.png").is_file()
    assert list((out / "coco").rglob("*.json"))


@pytest.mark.soak
@pytest.mark.system
def test_on_a_robot(tmp_path: Path) -> None:
    done = do_as_the_page_says("robot.md", tmp_path)
    assert len(done) >= 2
    assert (tmp_path / "out" / "rover_sensors.yaml").is_file()
    assert (tmp_path / "out" / "drive" / "report.html").is_file()
