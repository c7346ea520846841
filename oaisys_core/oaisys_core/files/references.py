"""What a file may refer to: files in its own folder or below, and in the asset roots."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from oaisys_core.errors import InvalidInputError, quote
from oaisys_core.files.path_fields import asset_root_folders

_allowed: ContextVar[tuple[Path, ...]] = ContextVar("allowed_folders", default=())


@contextmanager
def allow_references(*folders: Path) -> Iterator[None]:
    """Let files that are read inside this block refer to files in further folders, too."""
    token = _allowed.set(tuple(folder.resolve() for folder in folders))
    try:
        yield
    finally:
        _allowed.reset(token)


def folders_of(file: Path) -> tuple[Path, ...]:
    """Return the folders in which the files that a file refers to may lie, links resolved."""
    return (file.resolve().parent, *asset_root_folders(), *_allowed.get())


def lies_within(path: Path, folders: tuple[Path, ...]) -> bool:
    """Return whether a path, links resolved, lies in one of the folders."""
    try:
        found = path.resolve()
    except (OSError, RuntimeError, ValueError):  # links in a circle, a null byte
        return False
    return any(found.is_relative_to(folder) for folder in folders)


def outside_error(file: Path, name: str, field: str) -> InvalidInputError:
    """Return the error about a file that refers to another one elsewhere."""
    expected = (
        f"a file that refers only to files in its own folder or in the asset roots, not to"
        f" {quote(name)}"
    )
    return InvalidInputError(field, str(file), expected)


def resolve_reference(file: Path, name: str, field: str) -> Path:
    """Return the path of a file that another one refers to by a relative path.

    Raises:
        InvalidInputError: It is an absolute path, an address, or leads elsewhere.
    """
    plain = unquote(name).replace("\\", "/")
    if "://" in plain or "\0" in plain or PurePosixPath(plain).is_absolute() or plain[1:3] == ":/":
        raise outside_error(file, name, field)
    path = file.resolve().parent / plain
    if not lies_within(path, folders_of(file)):
        raise outside_error(file, name, field)
    return path
