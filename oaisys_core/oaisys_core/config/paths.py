"""Files and folders that a configuration names, relative to the file it stands in."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, ValidationInfo

BASE = "base"
"""Key of pydantic's context that holds the folder which relative paths are taken from."""


def _file(path: Path, info: ValidationInfo) -> Path:
    found = _absolute(path, info)
    if not found.is_file():
        raise ValueError(f"expected an existing file ({found})")
    return found


def _folder(path: Path, info: ValidationInfo) -> Path:
    found = _absolute(path, info)
    if not found.is_dir():
        raise ValueError(f"expected an existing folder ({found})")
    return found


def _absolute(path: Path, info: ValidationInfo) -> Path:
    base = (info.context or {}).get(BASE, Path())
    return Path(base, path.expanduser()).resolve()


ConfigFile = Annotated[Path, AfterValidator(_file)]
"""An existing file; relative ones are taken from the configuration file's folder."""

ConfigFolder = Annotated[Path, AfterValidator(_folder)]
"""An existing folder; relative ones are taken from the configuration file's folder."""
