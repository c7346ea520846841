"""Commands of `oaisys`, run as a user runs them."""

from __future__ import annotations

import subprocess
import sys

TIMEOUT_S = 300.0


def oaisys(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a command to its end, and return how it ended and what it said."""
    command = [sys.executable, "-m", "oaisys_core", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
