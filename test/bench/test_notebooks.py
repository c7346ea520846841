"""The notebooks, run cell by cell by IPython, which is also what runs them in Jupyter."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from repository import REPOSITORY
from waiting import START_PATIENCE_S

NOTEBOOKS = REPOSITORY / "examples" / "notebooks"


RUN = """
import sys
from IPython.core.interactiveshell import InteractiveShell
InteractiveShell.instance().safe_execfile_ipy(sys.argv[1], raise_exceptions=True)
"""


def run(notebook: Path, folder: Path, **environment: str) -> str:
    """Return what a notebook's cells print; each must work."""
    ended = subprocess.run(
        [sys.executable, "-c", RUN, str(notebook)],
        cwd=folder,
        env={**os.environ, "IPYTHONDIR": str(folder / "ipython"), **environment},
        capture_output=True,
        text=True,
        timeout=2 * START_PATIENCE_S,
        check=False,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


def test_a_cell_that_fails_is_noticed(tmp_path: Path) -> None:
    cell = {"cell_type": "code", "id": "a", "metadata": {}, "outputs": [], "source": "1 / 0"}
    notebook = {"cells": [cell | {"execution_count": None}], "metadata": {}}
    file = tmp_path / "wrong.ipynb"
    file.write_text(json.dumps(notebook | {"nbformat": 4, "nbformat_minor": 5}))
    with pytest.raises(AssertionError, match="ZeroDivisionError"):
        run(file, tmp_path)


def test_one_view(tmp_path: Path) -> None:
    printed = run(NOTEBOOKS / "01_one_view.ipynb", tmp_path)
    assert "objects are in view" in printed
    assert "class 1: 9" in printed


@pytest.mark.usefixtures("no_process_left")
def test_over_grpc(tmp_path: Path) -> None:
    printed = run(NOTEBOOKS / "02_over_grpc.ipynb", tmp_path)
    assert printed.index("sample 2: depth is here") < printed.index("sample 2: rgb is here")
    assert "refused: pose.position" in printed


@pytest.mark.ros
@pytest.mark.usefixtures("no_process_left")
def test_a_planner(tmp_path: Path, ros_domain_id: int) -> None:
    printed = run(NOTEBOOKS / "03_planner.ipynb", tmp_path, ROS_DOMAIN_ID=str(ros_domain_id))
    assert printed.count("depth is here") == 3
