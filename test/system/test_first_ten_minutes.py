"""A newcomer does what the pages of Start say, literally, in a fresh clone with an empty home.

Each page is one script of one shell: its blocks in order, set-up included, its files written where
the page says so. Only the caches of packages are those of this machine.
"""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest
from repository import REPOSITORY

BLOCK = re.compile(r"```(bash|yaml)\n(.*?)```", re.DOTALL)
FILE = re.compile(r"Write this to `([\w/.]+)`")
TIMEOUT_S = 3000.0


def script_of(page: str) -> str:
    """Return a page's blocks as a script of bash, which ends at the first command that fails."""
    text = (REPOSITORY / "docs" / "start" / page).read_text(encoding="utf-8")
    parts = ["set -exo pipefail"]
    for match in BLOCK.finditer(text):
        language, content = match.groups()
        if language == "yaml":
            name = FILE.findall(text[: match.start()])[-1]
            content = f"mkdir -p $(dirname {name})\ncat > {name} <<'END'\n{content}END\n"
        parts.append(content)
    return "\n".join(parts)


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh clone of what is committed here."""
    folder = tmp_path_factory.mktemp("newcomer") / "clone"
    command = ["git", "clone", "--quiet", "--shared", str(REPOSITORY), str(folder)]
    subprocess.run(command, check=True, timeout=120)
    return folder


def do_as_the_page_says(page: str, clone: Path, home: Path) -> str:
    """Run a page in a clone, as somebody who has nothing yet, and return what the shell ran."""
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    kept = {name: value for name, value in os.environ.items() if name.startswith(("PIP_", "UV_"))}
    path = os.pathsep.join(
        each for each in os.environ["PATH"].split(os.pathsep) if ".venv" not in each
    )
    environment = kept | {"HOME": str(home), "PATH": path}
    environment |= {"UV_CACHE_DIR": str(caches / "uv")}
    ended = subprocess.run(
        ["bash", "-c", script_of(page)],
        cwd=clone,
        env=environment,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert ended.returncode == 0, f"{ended.stdout[-3000:]}\n{ended.stderr[-3000:]}"
    return ended.stderr


@pytest.mark.soak
@pytest.mark.system
@pytest.mark.timeout(TIMEOUT_S)
def test_without_ros(clone: Path, tmp_path: Path) -> None:
    ran = do_as_the_page_says("no_ros.md", clone, tmp_path)
    assert "+ make setup" in ran
    assert ran.count("\n+ oaisys ") >= 6
    out = clone / "out"
    assert len(list(out.glob("start/batch_0001/camera/*.png"))) == 3
    assert (out / "one_view.png").is_file()
    assert list((out / "coco").rglob("*.json"))


@pytest.mark.soak
@pytest.mark.system
@pytest.mark.timeout(TIMEOUT_S)
def test_on_a_robot(clone: Path, tmp_path: Path) -> None:
    """The page goes on from set-up, which Start's first page has."""
    do_as_the_page_says("index.md", clone, tmp_path)
    set_up = f"source {clone}/.venv/oaisys_env.sh"
    ended = subprocess.run(
        ["bash", "-c", f"{set_up}\n{script_of('robot.md')}"],
        cwd=clone,
        env={"HOME": str(tmp_path), "PATH": "/usr/local/bin:/usr/bin:/bin"},
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr[-3000:]
    assert (clone / "out" / "rover_sensors.yaml").is_file()
    assert (clone / "out" / "drive" / "report.html").is_file()
