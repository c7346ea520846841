"""Runs a module of this folder in a process of its own."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

from oaisys_core.system.python_programs import python_command
from oaisys_mapping.odometry.programs import run_program
from tools.programs import PATH_VARIABLE, tool_environment


def run_module(name: str, *arguments: str) -> list[str]:
    """Run a module in an empty folder and return the lines that it prints.

    Args:
        name: The module's full name.
        arguments: Its arguments; paths are absolute.

    Raises:
        ProgramError: It failed, or took too long.
    """
    path = {PATH_VARIABLE: tool_environment()[PATH_VARIABLE]}
    with tempfile.TemporaryDirectory() as folder:
        printed = run_program(python_command(name, *arguments), Path(folder), path)
    return printed.strip().splitlines()


def run_for_json(name: str, *arguments: str) -> Any:
    """Run a module and return its last line, as JSON; libraries print before it.

    Raises:
        ProgramError: It failed, or took too long.
    """
    return json.loads(run_module(name, *arguments)[-1])
