"""Files that are complete under their name, or not there, whenever the program is killed."""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a new file beside ``path``, which gets its name once the block has ended.

    If the block fails, it is removed, and a file that was there before stays. A program that is
    killed may leave it behind, under its own name, which ends in ``.part``.

    Raises:
        OSError: It cannot be made or renamed, or ``path`` is a device or a pipe, such as /dev/null.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise OSError(errno.EINVAL, "it exists, and is no regular file", str(path))
    partial = path.with_name(f"{path.name}.{secrets.token_hex(4)}.part")
    os.close(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666))
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
