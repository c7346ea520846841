"""Calls functions in a process of their own, where Blender may be imported.

Blender's data is global to a process and does not get on with an Open3D that came first, so no
test imports it into pytest's process. Tests that need Blender are skipped where it is not
installed, and for no other reason.
"""

from __future__ import annotations

import importlib
import importlib.util
import pickle
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

TIMEOUT_S = 500
"""Less than that of a test, so that it is told what did not end."""


def skip_without_blender(*, module: bool = False) -> None:
    """Skip the test, or the whole module, where there is no ``bpy``; nothing is imported."""
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("bpy is not installed", allow_module_level=module)


def require_blender() -> None:
    """As `skip_without_blender`; where there is a ``bpy`` it must import, else the test fails."""
    skip_without_blender()
    importlib.import_module("bpy")


def in_blender(job: str, *arguments: Any) -> Any:
    """Return what a function of `blender_jobs` returns in a new process.

    ``job`` is ``module.function``. Arguments and result are pickled. Skips the test where there is
    no ``bpy``.
    """
    skip_without_blender()
    with tempfile.TemporaryDirectory() as folder:
        exchange = Path(folder, "exchange")
        exchange.write_bytes(pickle.dumps(arguments))
        process = subprocess.run(
            [sys.executable, __file__, job, exchange],
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
        if process.returncode:
            pytest.fail(f"{job} in Blender's process:\n{process.stderr[-4000:]}")
        return pickle.loads(exchange.read_bytes())


if __name__ == "__main__":
    sys.path.append(str(Path(__file__).resolve().parents[2]))  # for tools.bench.cycles_passes
    name, file = sys.argv[1], Path(sys.argv[2])
    module, function = name.split(".")
    call = getattr(importlib.import_module(f"blender_jobs.{module}"), function)
    file.write_bytes(pickle.dumps(call(*pickle.loads(file.read_bytes()))))
