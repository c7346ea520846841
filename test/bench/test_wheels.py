"""The wheels hold all that the packages need, outside of the repository."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest
import yaml
from PIL import Image
from repository import REPOSITORY

from tools.wheels import PACKAGES, build_wheels

TIMEOUT_S = 300.0

WORLD = {
    "seed": 4,
    "backend": "analytic",
    "stage": {"extent_m": 30, "resolution_px": 121},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 128}},
    "sensors": {"cameras": [{"width_px": 64, "height_px": 48, "fx_px": 54.114, "fy_px": 54.114}]},
}

WHERE = """
import importlib, json, sys
print(json.dumps([importlib.import_module(name).__file__ for name in sys.argv[1:]]))
"""


def run(python: Path, folder: Path, *arguments: str) -> str:
    """Return what a program of the new environment prints; nothing of this one is on its paths."""
    kept = {name: os.environ[name] for name in ("HOME", "PATH") if name in os.environ}
    ended = subprocess.run(
        [str(python), "-P", *arguments],
        cwd=folder,
        env=kept,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


@pytest.mark.system
def test_an_example_runs_from_wheels_outside_of_the_repository(tmp_path: Path) -> None:
    before = set(REPOSITORY.rglob("*.egg-info"))
    wheels = build_wheels(tmp_path / "wheels")
    assert [wheel.name.split("-")[0] for wheel in wheels] == sorted(PACKAGES)
    assert set(REPOSITORY.rglob("*.egg-info")) == before
    venv.create(tmp_path / "empty", with_pip=False)
    python = tmp_path / "empty" / "bin" / "python"
    install = ["-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps"]
    command = [sys.executable, *install, "--no-index", *map(str, wheels)]
    subprocess.run(command, check=True, timeout=TIMEOUT_S)
    # Packages of others are found where they are; ours are links there, which such a line ignores.
    site = next((tmp_path / "empty" / "lib").glob("python*/site-packages"))
    (site / "others.pth").write_text(sysconfig.get_path("purelib"), encoding="utf-8")
    imported = json.loads(run(python, tmp_path, "-c", WHERE, *PACKAGES[:-1]))
    assert all(Path(file).is_relative_to(site) for file in imported)

    example = shutil.copy(REPOSITORY / "examples" / "01_one_view.py", tmp_path)
    (tmp_path / "world.yaml").write_text(yaml.safe_dump(WORLD), encoding="utf-8")
    printed = run(python, tmp_path, str(example), "world.yaml", "--out", "view.png")
    assert "nearest" in printed
    with Image.open(tmp_path / "view.png") as picture:
        assert picture.size == (64, 48)
        assert len(picture.getcolors(64 * 48) or ()) > 100
    assert "Render:" in run(python, tmp_path, "-m", "oaisys_core", "--help")
