"""What must be there before set-up starts: disk space and a compiler."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import tempfile
from pathlib import Path

from tools.setup.errors import SetupError

NEEDED_DISK_GB = 5.0
"""Measured: 3 GB when done, and 1.2 GB of wheels beside it while they are unpacked."""

_TRIAL_SOURCES = {
    "trial.c": '#include <stdio.h>\nint main(void) { return puts("") < 0; }\n',
    "trial.cpp": '#include <string>\nint main() { return std::string("").size(); }\n',
}


def check_disk(folder: Path, needed_gb: float) -> None:
    """Raise `SetupError` where the file system of ``folder`` has less than ``needed_gb`` free."""
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    free_gb = shutil.disk_usage(existing).free / 1e9
    if free_gb < needed_gb:
        raise SetupError(
            f"not enough disk space for {folder}: {free_gb:.1f} GB free, {needed_gb:.0f} GB needed"
        )


def check_compiler() -> None:
    """Raise `SetupError` where no C or C++ program can be compiled and linked.

    ``CC`` and ``CXX`` are honoured, as CMake does.
    """
    _compile("C", os.environ.get("CC"), ("cc", "gcc", "clang"), "trial.c")
    _compile("C++", os.environ.get("CXX"), ("c++", "g++", "clang++"), "trial.cpp")


def _compile(language: str, chosen: str | None, usual: tuple[str, ...], source: str) -> None:
    commands = [shlex.split(chosen)] if chosen else [[name] for name in usual]
    found = next((command for command in commands if shutil.which(command[0])), None)
    if found is None:
        names = chosen or ", ".join(usual)
        raise SetupError(f"no {language} compiler found ({names}): apt install build-essential")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, source)
        file.write_text(_TRIAL_SOURCES[source])
        result = subprocess.run(
            [*found, str(file), "-o", str(Path(folder, "trial"))],
            capture_output=True,
            text=True,
            check=False,
        )
    if result.returncode:
        fault = next((line for line in result.stderr.splitlines() if "error" in line), "no message")
        raise SetupError(f"the {language} compiler {found[0]} does not work: {fault.strip()}")
