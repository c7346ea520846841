"""Runs a module of this folder in a process of its own."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from oaisys_mapping.odometry.programs import run_program


def run_module(name: str, *arguments: str) -> list[str]:
    """Run ``python -m NAME ARGUMENTS`` in this folder and return the lines that it prints.

    Raises:
        ProgramError: It failed, or took too long.
    """
    return run_program([sys.executable, "-m", name, *arguments], Path.cwd()).strip().splitlines()


def printed_json(name: str, *arguments: str) -> Any:
    """Run a module and return its last line, as JSON; libraries print before it.

    Raises:
        ProgramError: It failed, or took too long.
    """
    return json.loads(run_module(name, *arguments)[-1])
