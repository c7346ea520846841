"""What goes wrong while an object is read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_core.files.documents import DocumentError


@contextmanager
def require_found(url: str, name: str) -> Iterator[None]:
    """Raise what a place raises if its object does not exist, or cannot be read."""
    try:
        yield
    except (FileNotFoundError, NotADirectoryError) as error:
        raise NotFoundError(f"{url}/{name}: does not exist") from error
    except (OSError, DocumentError) as error:
        raise InvalidInputError("file", f"{url}/{name}", f"a readable file ({error})") from error
