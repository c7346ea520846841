"""Commands of `oaisys`, run as a user runs them."""

from __future__ import annotations

import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from unittest.mock import patch

from oaisys_core.cli.main import main

TIMEOUT_S = 300.0


def oaisys(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a command to its end, and return how it ended and what it said."""
    command = [sys.executable, "-m", "oaisys_core", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)


def oaisys_here(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a command in this process, without a start: where the program is not the subject.

    What a program would end with a traceback for is raised.
    """
    command = ["oaisys", *map(str, arguments)]
    out, err, code = StringIO(), StringIO(), 0
    with patch.object(sys, "argv", command), redirect_stdout(out), redirect_stderr(err):
        try:
            main()
        except SystemExit as ended:
            code = int(ended.code or 0)
    return subprocess.CompletedProcess(command, code, out.getvalue(), err.getvalue())
