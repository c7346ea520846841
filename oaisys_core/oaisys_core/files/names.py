"""Names of files and folders that come from outside, such as a data set that somebody else wrote.

Whoever makes a path from a name out of a file calls `path_inside`; it is the one place that says
which names may become a file.
"""

from __future__ import annotations

from pathlib import Path

from oaisys_core.errors import InvalidInputError

MAX_NAME_BYTES = 200
"""Longest name: file systems take 255 bytes, and a name gets endings such as ``.normal.tif``."""

NAME_EXPECTED = f"a name of at most {MAX_NAME_BYTES} bytes: letters, digits, _, inside also . + -"
_SIGNS = frozenset("_.+-")


def is_name(text: str) -> bool:
    """Return whether a text may name a file: no separator, no drive, no dots, not too long."""
    return (
        bool(text)
        and (text[0].isalnum() or text[0] == "_")
        and text[-1] not in "."
        and all(letter.isalnum() or letter in _SIGNS for letter in text)
        and len(text.encode("utf-8", "replace")) <= MAX_NAME_BYTES
    )


def path_inside(folder: Path, *names: str) -> Path:
    """Return the path of a file or folder in ``folder``, which cannot be anywhere else.

    Args:
        folder: A folder of ours.
        names: Names of the folders on the way and of the file; one with slashes, such as
            ``rgb/1.png``, names a file in a folder.

    Raises:
        InvalidInputError: A name is not one of a file.
    """
    parts = [part for name in names for part in name.split("/")]
    for part in parts:
        if not is_name(part):
            raise InvalidInputError("name of a file", part, NAME_EXPECTED)
    return folder.joinpath(*parts)
