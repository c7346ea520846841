"""Paths inside installed files: those of the machine that built a file become this machine's."""

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
    """Replace the build machine's paths in every text file under ``prefix/share``.

    A second call changes nothing.

    Args:
        prefix: The virtual environment.
        python_include: The folder with the interpreter's ``Python.h``.
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
        replace_file(file, new, file.stat().st_mode)
        rewritten += 1
    return rewritten


def replace_file(file: Path, content: bytes, mode: int) -> None:
    """Put a new file in the place of ``file``, which keeps its content under its other names.

    uv links installed files to those in its cache, so that writing into one would change both.
    """
    beside = file.with_name(f".{file.name}.new")
    beside.write_bytes(content)
    beside.chmod(mode)
    beside.replace(file)


def _literal(path: Path) -> bytes:
    """Return ``path`` as a literal replacement text."""
    return bytes(path).replace(b"\\", rb"\\")
