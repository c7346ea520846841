"""How the tools start each other: found in this checkout, whatever the current folder is.

The tools are not installed, and nothing may be imported from the current folder, so what they start
is told where they are. That holds for all further programs as well, such as the workers of Ray.
"""

from __future__ import annotations

import os
from pathlib import Path

from oaisys_core.system.ending.owner import owner_variables
from oaisys_core.system.python_programs import python_environment

ROOT = Path(__file__).parents[1]
"""The checkout that these tools are part of."""

PATH_VARIABLE = "PYTHONPATH"


def tool_environment(*first: Path) -> dict[str, str]:
    """Return the variables for a program that imports the tools, and for all that it starts.

    Args:
        first: Folders whose packages are found before the installed ones.
    """
    given = os.environ.get(PATH_VARIABLE, "").split(os.pathsep)
    folders = [*map(str, (*first, ROOT)), *filter(None, given)]
    path = os.pathsep.join(dict.fromkeys(folders))
    return python_environment({**os.environ, PATH_VARIABLE: path}) | owner_variables()
