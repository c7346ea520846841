"""A folder that appears under its name when all that belongs in it is there."""

from __future__ import annotations

import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from oaisys_core.files.folders import make_folder
from oaisys_core.system.ending.leftovers import remove_when_killed


@contextmanager
def whole_folder(target: Path) -> Iterator[Path]:
    """Yield an empty folder that becomes ``target`` if the block succeeds.

    Args:
        target: A path where there is nothing, or an empty folder.

    Raises:
        OSError: It could not be made or renamed; nothing is left.
    """
    # A name that nobody can foresee: the folder may be in a data set of somebody else.
    part = target.with_name(f".{target.name}.{uuid.uuid4().hex}.part")
    make_folder(target.parent)
    with remove_when_killed(part):
        try:
            make_folder(part)
            yield part
            part.replace(target)
        finally:
            shutil.rmtree(part, ignore_errors=True)
