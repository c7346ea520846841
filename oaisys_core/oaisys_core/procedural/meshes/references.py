"""The files that a mesh file refers to: buffers, materials and textures."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from oaisys_core.errors import InvalidInputError, show_field
from oaisys_core.files.documents import read_bytes
from oaisys_core.files.image_formats.image_headers import image_size
from oaisys_core.files.image_formats.image_use import MESH_TEXTURE
from oaisys_core.files.mesh_formats.mesh_headers import MAX_BYTES
from oaisys_core.files.references import resolve_reference

LOG = logging.getLogger(__name__)

IMAGE_SUFFIXES = frozenset(
    (
        *(".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".gif", ".tga", ".dds"),
        *(".ktx", ".ktx2", ".exr", ".hdr", ".eps", ".ppm", ".pgm", ".psd"),
    )
)

MOST_NAMES = 5
"""Names in a warning."""

LACKING = "what it colours has a plain colour"


class FileReferences:
    """What trimesh asks for files; it goes on without what it does not get, so refusals are kept.

    Attributes:
        refused: The first file that was refused; None: none.
    """

    def __init__(self, file: Path, field: str) -> None:
        self._file, self._field = file, field
        self.refused: InvalidInputError | None = None
        self._missing: dict[str, None] = {}

    def place(self, name: str) -> Path:
        """Return where a file lies, links resolved: the same for all spellings of its name.

        Raises:
            InvalidInputError: It lies elsewhere.
        """
        return resolve_reference(self._file, str(name), self._field).resolve()

    def get(self, name: str) -> bytes:
        """Return the content of a file; `tell_missing` says which ones are not there.

        Raises:
            InvalidInputError: It lies elsewhere, or is too large.
            OSError: It is not there.
        """
        try:
            path = self.place(name)
            data = self._content(path)
            if path.suffix.lower() in IMAGE_SUFFIXES:
                check_texture(data, str(path))
        except InvalidInputError as error:
            self.refused = self.refused or error
            raise
        except OSError:
            self._missing[str(name)] = None
            raise
        return data

    def tell_missing(self) -> None:
        """Log in one line the files that are not there; of many, the first suffice."""
        if not self._missing:
            return
        count = len(self._missing)
        shown = ", ".join(map(repr, list(self._missing)[:MOST_NAMES]))
        if count > 1:
            shown += f"{', …' if count > MOST_NAMES else ''} ({count})"
        verb = "is" if count == 1 else "are"
        LOG.warning("%s: %s, which it refers to, %s missing: %s", self._file, shown, verb, LACKING)

    def find(self, name: str) -> bytes | None:
        """Return the content of a file likewise; None: it is not there."""
        try:
            return self.get(name)
        except OSError:
            return None

    def peek(self, name: str) -> bytes | None:
        """Return the content of a file if it is there, else None without a word."""
        path = self._file.parent / name
        return self.find(name) if path.is_file() else None

    def _content(self, path: Path) -> bytes:
        try:
            return read_bytes(path, MAX_BYTES)
        except ValueError as error:
            shown = show_field(path.name)
            expected = f"a file that refers to files that can be read ({shown}: {error})"
            raise InvalidInputError(self._field, str(self._file), expected) from error

    def __getitem__(self, name: str) -> bytes:
        return self.get(name)

    def __contains__(self, name: str) -> bool:
        return True

    def keys(self) -> list[str]:
        """Return the names of files that are known beforehand: none."""
        return []

    def write(self, name: str, data: Any) -> None:
        """Refuse: reading writes nothing."""
        raise NotImplementedError

    def namespaced(self, namespace: str) -> FileReferences:
        """Return what opens the files of a folder; the same, because names are relative paths."""
        return self


def check_texture(data: bytes, name: str) -> None:
    """Raise `InvalidInputError` if the image in a mesh's file must not be decoded."""
    try:
        size = image_size(data)
    except ValueError as error:
        raise MESH_TEXTURE.refusal(name, error) from error
    MESH_TEXTURE.check(*size, name)
