"""Files and folders in configurations and requests.

A configuration may name any file; relative paths start from the folder of the configuration file.
Paths in requests are `confine_paths` to the asset roots of the server's operator.
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ValidationInfo

from oaisys_core.errors import quote

BASE = "base"
"""Key of pydantic's context with the folder from which relative paths start."""


@dataclass(frozen=True)
class AssetRoots:
    """The files that a request may name.

    Attributes:
        folders: The root folders, with links resolved.
        named: Paths outside of them that are allowed because the configuration names them.
    """

    folders: tuple[Path, ...]
    named: frozenset[Path] = frozenset()

    @classmethod
    def of(cls, folders: Iterable[Path], config: BaseModel) -> AssetRoots:
        """Return the roots of a server with this configuration."""
        return cls(
            tuple(folder.resolve() for folder in folders),
            frozenset(_paths_in(config.model_dump())),
        )

    def find(self, path: Path) -> Path:
        """Return a path with all links resolved; relative paths are searched in each root.

        Raises:
            ValueError: It is not in a root. The message does not say whether it exists.
        """
        found = [self._resolve(root / path) for root in self.folders or (Path("/"),)]
        inside = [each for each in found if each is not None]
        if not inside:
            raise ValueError("expected a path inside the asset roots of the server")
        return next((each for each in inside if _holds(each.exists)), inside[0])

    def check_links(self, folder: Path) -> None:
        """Raise if a folder of a request contains links that lead out of the roots."""
        if folder in self.named:
            return
        for path in folder.rglob("*"):
            if path.is_symlink() and self._resolve(path) is None:
                raise ValueError("expected a folder whose links stay inside the asset roots")

    def _resolve(self, path: Path) -> Path | None:
        try:
            found = _resolve_links(path)
        except (OSError, RuntimeError):  # links in a circle
            return None
        is_inside = any(found.is_relative_to(root) for root in self.folders)
        return found if is_inside or found in self.named else None


_confinement: ContextVar[AssetRoots | None] = ContextVar("asset_roots", default=None)


@contextmanager
def confine_paths(roots: AssetRoots | None) -> Iterator[None]:
    """Require that all paths that are checked inside this block lie in the roots.

    Args:
        roots: The asset roots of the server; None if any file is allowed.
    """
    token = _confinement.set(roots)
    try:
        yield
    finally:
        _confinement.reset(token)


def asset_root_folders() -> tuple[Path, ...]:
    """Return the roots in force, with links resolved; none if any file is allowed."""
    roots = _confinement.get()
    return () if roots is None else roots.folders


def is_confined() -> bool:
    """Return whether a request is worked on, which may name files in the asset roots only."""
    return _confinement.get() is not None


def _not_empty(value: Any) -> Any:
    """Refuse empty text, which as a path is the folder of the configuration file."""
    if value == "":
        raise ValueError("expected a path, no empty text")
    return value


def _file(path: Path, info: ValidationInfo) -> Path:
    found = _absolute(path, info)
    if not _holds(found.is_file):
        raise ValueError(f"expected an existing file ({_shown(found)})")
    return found


def _folder(path: Path, info: ValidationInfo) -> Path:
    found = _absolute(path, info)
    if not _holds(found.is_dir):
        raise ValueError(f"expected an existing folder ({_shown(found)})")
    roots = _confinement.get()
    if roots is not None:
        roots.check_links(found)
    return found


def _file_or_folder(path: Path, info: ValidationInfo) -> Path:
    found = _absolute(path, info)
    return _folder(path, info) if _holds(found.is_dir) else _file(path, info)


def _absolute(path: Path, info: ValidationInfo) -> Path:
    roots = _confinement.get()
    if roots is not None:
        return roots.find(path)
    base = (info.context or {}).get(BASE, Path())
    try:
        return _resolve_links(Path(base, path.expanduser()))
    except (OSError, RuntimeError) as error:  # links in a circle, or ~ of a user who does not exist
        raise ValueError(f"expected a path that leads somewhere ({_reason(error)})") from error


def _resolve_links(path: Path) -> Path:
    """Return a path with all links resolved; `Path.resolve` from Python 3.13 on bears circles.

    Raises:
        OSError, RuntimeError: Its links go in a circle.
    """
    try:
        path.stat()
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise
    return path.resolve()


def _reason(error: Exception) -> str:
    is_circle = "Symlink loop" in str(error) or getattr(error, "errno", None) == errno.ELOOP
    return "its links go in a circle" if is_circle else str(error)


def _shown(path: Path) -> str:
    return quote(str(path)).strip("'")


def _holds(test: Callable[[], bool]) -> bool:
    """Return the result of a path test; False for names that no file can have."""
    try:
        return test()
    except OSError:
        return False


def _paths_in(value: Any) -> Iterator[Path]:
    """Yield the paths in the values of a section, and texts in options that look like paths."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, str) and value.startswith("/"):
        with suppress(OSError, RuntimeError, ValueError):  # it is no path
            yield _resolve_links(Path(value))
    elif isinstance(value, Mapping):
        for each in value.values():
            yield from _paths_in(each)
    elif isinstance(value, tuple | list):
        for each in value:
            yield from _paths_in(each)


NamedPath = Annotated[Path, BeforeValidator(_not_empty)]
"""A path that may not exist yet."""

ConfigFile = Annotated[NamedPath, AfterValidator(_file)]
"""An existing file; relative paths start from the folder of the configuration file."""

ConfigFolder = Annotated[NamedPath, AfterValidator(_folder)]
"""An existing folder; relative paths start from the folder of the configuration file."""

ConfigPath = Annotated[NamedPath, AfterValidator(_file_or_folder)]
"""An existing file or folder, such as a bag; relative paths start as those of `ConfigFile`."""
