"""Calls functions in a process of their own, where Blender may be imported.

Blender's data is global to a process and does not get on with an Open3D that came first, so no
test imports it into pytest's process.
"""

from __future__ import annotations

import importlib
import pickle
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
from needs_blender import skip_without_blender

TIMEOUT_S = 300


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
    name, file = sys.argv[1], Path(sys.argv[2])
    module, function = name.split(".")
    call = getattr(importlib.import_module(f"blender_jobs.{module}"), function)
    file.write_bytes(pickle.dumps(call(*pickle.loads(file.read_bytes()))))
