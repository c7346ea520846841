"""What programs of the tools answer to --help and to arguments that they do not know."""

from __future__ import annotations

import subprocess
from pathlib import Path

from waiting import START_PATIENCE_S

from oaisys_core.system.python_programs import python_command
from tools.programs import tool_environment

ANSWERS = (("--help", 0), ("--nonsense", 2))
"""An argument, and the exit code of its answer."""


def check_answer(module: str, argument: str, code: int, folder: Path) -> None:
    """Check that ``python -m module argument``, in an empty folder, tells its usage alone."""
    ended = subprocess.run(
        python_command(module, argument),
        cwd=folder,
        env=tool_environment(),
        capture_output=True,
        text=True,
        timeout=START_PATIENCE_S,
        check=False,
    )
    assert ended.returncode == code, ended.stderr
    said = ended.stderr if code else ended.stdout
    assert "usage" in said.lower()
    assert "Traceback" not in ended.stderr
    assert list(folder.iterdir()) == []
