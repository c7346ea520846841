"""`colcon test` runs pytest in each package's folder: it finds there what the repository has."""

from __future__ import annotations

import configparser
import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from repository import REPOSITORY

PACKAGES = ("core", "dataset", "grpc", "gym", "mapping", "ros_bridge")
"""Names without `oaisys_`; their tests are in folders of the same names."""
SHARED = ("timeout", "timeout_method")


def of_repository() -> dict[str, Any]:
    """Return the one table of how tests are run; the packages' files must agree with it."""
    settings = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    table: dict[str, Any] = settings["tool"]["pytest"]["ini_options"]
    return table


def of_package(name: str) -> configparser.SectionProxy:
    parser = configparser.ConfigParser(interpolation=None)
    parser.read(REPOSITORY / f"oaisys_{name}" / "setup.cfg", encoding="utf-8")
    return parser["tool:pytest"]


def test_every_package_with_tests_is_known() -> None:
    packages = {file.parent.name for file in REPOSITORY.glob("oaisys_*/setup.cfg")}
    assert packages == {f"oaisys_{name}" for name in PACKAGES}


@pytest.mark.parametrize("name", PACKAGES)
def test_a_package_runs_its_tests_as_the_repository_does(name: str) -> None:
    whole, own = of_repository(), of_package(name)
    folder = REPOSITORY / f"oaisys_{name}"

    assert own["testpaths"].split() == [f"../test/{name}"]
    paths = [Path(os.path.normpath(folder / path)) for path in own["pythonpath"].split()]
    assert paths == [REPOSITORY / path for path in whole["pythonpath"]]
    assert own["markers"].strip().splitlines() == whole["markers"]
    assert {key: own[key] for key in SHARED} == {key: str(whole[key]) for key in SHARED}
    # colcon's own pytest has options that --strict-config would refuse.
    assert set(own["addopts"].split()) == set(whole["addopts"]) - {"--strict-config"}


@pytest.mark.long
def test_a_packages_tests_are_collected_in_its_folder() -> None:
    """The others' files say the same, as the test above shows."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider"]
    result = subprocess.run(
        command,
        cwd=REPOSITORY / "oaisys_mapping",
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert result.returncode == 0, result.stdout[-3000:]
    assert "error" not in result.stdout.splitlines()[-1]
