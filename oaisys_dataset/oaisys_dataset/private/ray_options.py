"""Where Ray keeps its files, and how much memory it hands out.

Private part: the arguments ``_temp_dir`` and ``_memory`` of ``ray.init``.
Tried with: Ray 2.60.0.
Public way without it: the environment variable ``RAY_TMPDIR``; Ray takes memory as it finds it.
Lost without it: the limit; Ray starts as many workers as cores and free memory allow.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from oaisys_core.system.fallbacks import report_fallback

FOLDER, MEMORY = "_temp_dir", "_memory"
"""Names of the arguments."""

UNKNOWN = "Unknown keyword argument"
"""How Ray's error begins if it does not know an argument."""


def start_in(ray: Any, folder: Path, memory_bytes: int, **options: Any) -> None:
    """Call ``ray.init``: with its files in a folder, and with so much memory for all workers."""
    try:
        ray.init(**options, **{FOLDER: str(folder), MEMORY: memory_bytes})
    except RuntimeError as error:
        if UNKNOWN not in str(error):
            raise
        report_fallback(
            "Ray's folder and memory", str(error), "Ray counts itself how many workers fit"
        )
        _start_by_variable(ray, folder, options)


def _start_by_variable(ray: Any, folder: Path, options: dict[str, Any]) -> None:
    before = os.environ.get("RAY_TMPDIR")
    os.environ["RAY_TMPDIR"] = str(folder)
    try:
        ray.init(**options)
    finally:
        os.environ.pop("RAY_TMPDIR")
        if before is not None:
            os.environ["RAY_TMPDIR"] = before
