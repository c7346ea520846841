"""Makes the ROS wheels' files point at this environment, not at the one they were built in."""

from __future__ import annotations

import re
from pathlib import Path

_BUILD_PREFIX = rb"/opt/python/cp\d+-cp\d+"
_PYTHON_INCLUDE = re.compile(_BUILD_PREFIX + rb"/include/python3\.\d+")
_NUMPY_INCLUDE = re.compile(
    _BUILD_PREFIX + rb"/lib/python3\.\d+/site-packages/numpy/_?core/include"
)
_PREFIX = re.compile(_BUILD_PREFIX)


def relocate(prefix: Path, python_include: Path, numpy_include: Path) -> int:
    """Rewrite the build machine's paths in every text file under ``prefix/share``.

    Doing it again changes nothing.

    Args:
        prefix: The virtual environment.
        python_include: The folder that holds the interpreter's ``Python.h``.
        numpy_include: The folder of numpy's headers.

    Returns:
        The number of files that were rewritten.
    """
    replacements = (
        (_PYTHON_INCLUDE, _literal(python_include)),
        (_NUMPY_INCLUDE, _literal(numpy_include)),
        (_PREFIX, _literal(prefix)),
    )
    rewritten = 0
    for file in sorted((prefix / "share").rglob("*")):
        if not file.is_file() or file.is_symlink():
            continue
        old = file.read_bytes()
        if b"\0" in old or not _PREFIX.search(old):
            continue
        new = old
        for pattern, path in replacements:
            new = pattern.sub(path, new)
        file.write_bytes(new)
        rewritten += 1
    return rewritten


def _literal(path: Path) -> bytes:
    """Return ``path`` as a replacement in which nothing is special."""
    return bytes(path).replace(b"\\", rb"\\")
