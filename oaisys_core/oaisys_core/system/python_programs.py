"""How this project starts Python programs: nothing is imported from the current folder.

``python -m`` looks for modules in the current folder first, where an innocent ``random.py`` or a
planted ``numpy.py`` would be run.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path

_HERE = ("", ".")


def python_command(module: str, *arguments: str, python: str | Path = sys.executable) -> list[str]:
    """Return the command that runs a module of an installed package.

    >>> python_command("oaisys_grpc", "serve", python="python3")
    ['python3', '-P', '-m', 'oaisys_grpc', 'serve']
    """
    return [str(python), "-P", "-m", module, *arguments]


def python_environment(environment: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the variables for a Python program and all that it starts.

    Those of this process, if no others are given.
    An empty entry of ``PYTHONPATH``, as in ``:/packages``, means the current folder and is dropped.
    """
    found = dict(os.environ if environment is None else environment)
    found["PYTHONSAFEPATH"] = "1"
    if "PYTHONPATH" in found:
        folders = found["PYTHONPATH"].split(os.pathsep)
        found["PYTHONPATH"] = os.pathsep.join(each for each in folders if each not in _HERE)
    return found
