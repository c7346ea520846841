"""Paths that a user wrote, in which ``~`` is a home folder as in a shell.

A shell expands it neither in ``--out=~/x`` nor in a service's request or a parameter: a folder of
that name was made.
"""

from __future__ import annotations

from pathlib import Path

from oaisys_core.errors import InvalidInputError


def user_path(text: str | Path, field: str) -> Path:
    """Return a path in which ``~`` or ``~NAME`` at the begin is the home folder of a user.

    Files that are called so are named with their folder's absolute path.

    Args:
        text: The path.
        field: What the user calls it, in errors.

    Raises:
        InvalidInputError: There is no such user, or nobody knows where this one's home is.
    """
    path = Path(text)
    try:
        return path.expanduser()
    except RuntimeError:
        name = path.parts[0][1:]
        expected = f"~NAME of a user of this machine, not {name!r}" if name else "no ~ without HOME"
        raise InvalidInputError(field, str(path), expected) from None
