"""The statements of .obj files, as the format's specification says, and their line numbers."""

from __future__ import annotations

import io
import os
from array import array
from collections.abc import Callable, Iterator, Sequence
from itertools import repeat
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import quote
from oaisys_core.files.mesh_formats.mesh_headers import MAX_VERTICES
from oaisys_core.files.mesh_formats.mesh_texts import check_parts
from oaisys_core.files.numbers import check_digits
from oaisys_core.types import FloatArray

ABSENT = -(2**62)
"""Index of a corner that has no texture coordinates, or no normal."""

LEFT_OUT = frozenset(
    (
        *(b"g", b"s", b"mg", b"p", b"l", b"lod", b"bevel", b"c_interp", b"d_interp", b"vp"),
        *(b"ctech", b"stech", b"shadow_obj", b"trace_obj"),
    )
)
"""Statements that neither shape nor colour a surface of polygons."""

REFUSED = {
    b"surf": "polygons in place of free-form surfaces",
    b"call": "no calls of other files",
    b"csh": "no commands",
}

NUMBERS = frozenset((b"v", b"vt", b"vn", b"f", b"fo"))
"""Statements behind whose numbers a comment may stand; names may contain its mark."""


MAX_UNKNOWN = 5
"""Unknown keywords that a warning names."""


class FaceGroup(NamedTuple):
    """What the faces of one part have in common: also whether they have texture coordinates."""

    object: str | None
    material: str | None
    has_uv: bool


class ObjStatements:
    """What an .obj file says.

    Attributes:
        counts: (F,) corners of each face.
        lines: (F,) line of each face.
        group_of: (F,) index of each face into ``groups``.
        groups: In the order of the file.
        libraries: What stands behind ``mtllib``, once each, as `file_name` returns it.
        materials: What stands behind ``usemtl``, once each, as `name_text` returns it.
        unknown: The first keywords that the specification does not have.
    """

    def __init__(self, data: bytes) -> None:
        """Read a file's content.

        Raises:
            ValueError: It cannot be read as the specification says; the error has the line.
        """
        self.libraries: dict[str, None] = {}
        self.materials: dict[str, None] = {}
        self.unknown: dict[str, None] = {}
        self._groups: dict[FaceGroup, int] = {}
        self._object: str | None = None
        self._material: str | None = None
        self._vertices, self._colors, self._uv = array("d"), array("d"), array("d")
        self._color_row, self._vertex_lines = array("q"), array("q")
        self._totals = [0, 0, 0]
        self._corners = (array("q"), array("q"), array("q"))
        self._counts, self._lines, self._group_of = array("q"), array("q"), array("q")
        self._before = array("q")
        self._read(data)
        self.groups = tuple(self._groups)
        self.counts, self.lines = _integers(self._counts), _integers(self._lines)
        self.group_of = _integers(self._group_of)

    @property
    def vertices(self) -> FloatArray:
        """(V, 3) coordinates."""
        return np.frombuffer(self._vertices, np.float64).reshape(-1, 3)

    @property
    def uv(self) -> FloatArray:
        """(N, 2) texture coordinates."""
        return np.frombuffer(self._uv, np.float64).reshape(-1, 2)

    def colors(self, vertices: NDArray[np.int64]) -> NDArray[np.uint8] | None:
        """Return the (N, 3) colours in sRGB of vertices by their indices; None: they have none.

        Raises:
            ValueError: Some have colours and some have none, or they are not from 0 to 1.
        """
        rows = _integers(self._color_row)[vertices]
        if (rows < 0).all():
            return None
        lines = _integers(self._vertex_lines)[vertices]
        if (rows < 0).any():
            lacking = int(lines[rows < 0].min())
            raise ValueError(f"colours at all vertices of an object or at none: line {lacking}")
        colors = np.frombuffer(self._colors, np.float64).reshape(-1, 3)[rows]
        # Some are rounded up in their last digit.
        bad = ~((colors >= -0.001) & (colors <= 1.001)).all(axis=1)
        if bad.any():
            numbers = ", ".join(f"{value:g}" for value in colors[bad][0])
            raise ValueError(f"vertex colours from 0 to 1, not ({numbers}): line {lines[bad][0]}")
        return np.asarray(np.rint(colors.clip(0, 1) * 255), np.uint8)

    def corners(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return the (C,) indices, from 0, of all corners into ``v``, ``vt`` and ``vn``; -1: none.

        Raises:
            ValueError: One of them is 0, or beyond what there is.
        """
        before = _integers(self._before).reshape(-1, 3)
        v, vt, vn = (
            self._resolve(_integers(given), np.repeat(before[:, kind], self.counts), kind)
            for kind, given in enumerate(self._corners)
        )
        return v, vt, vn

    def _resolve(
        self, given: NDArray[np.int64], before: NDArray[np.int64], kind: int
    ) -> NDArray[np.int64]:
        total = self._totals[kind]
        is_absent = given == ABSENT
        found = np.where(given > 0, given - 1, given + before)
        bad = ~is_absent & ((given == 0) | (found < 0) | (found >= total))
        if bad.any():
            corner = int(np.argmax(bad))
            line = self.lines[np.searchsorted(np.cumsum(self.counts), corner, side="right")]
            name = ("v", "vt", "vn")[kind]
            raise ValueError(
                f"faces with indices of {name} from 1 to {total}, or from -1 to -{before[corner]},"
                f" not {given[corner]}: line {line}"
            )
        found[is_absent] = -1
        return found

    def _read(self, data: bytes) -> None:
        readers: dict[bytes, Callable[[int, Sequence[bytes]], None]] = {
            b"v": self._vertex,
            b"vt": self._texture,
            b"vn": self._normal,
            b"f": self._face,
            b"fo": self._face,
        }
        for line, text in logical_lines(data):
            words = text.split()
            if not words or words[0].startswith(b"#"):
                continue
            key = words[0]
            if key in NUMBERS:
                if b"#" in text:
                    words = text[: text.index(b"#")].split()
                try:
                    readers[key](line, words)
                except (ValueError, OverflowError) as error:
                    shown = quote(name_text(text.strip()))
                    raise ValueError(f"{error}, not {shown}: line {line}") from error
            elif key not in LEFT_OUT:
                self._name(line, key, text.strip()[len(key) :].strip())

    def _name(self, line: int, key: bytes, value: bytes) -> None:
        """Take what changes the names of the faces that follow."""
        name = name_text(value)
        if key == b"mtllib":
            self.libraries[file_name(value)] = None
            check_parts(len(self.libraries), f"material libraries (line {line}): join them")
        elif key == b"usemtl":
            self._material = name
            self.materials[name] = None
            check_parts(len(self.materials), f"materials (line {line}): merge them")
        elif key == b"o":
            self._object = name
        elif key in REFUSED:
            raise ValueError(f"{REFUSED[key]}: line {line}")
        elif len(self.unknown) < MAX_UNKNOWN:
            self.unknown[name_text(key)] = None

    def _vertex(self, line: int, words: Sequence[bytes]) -> None:
        numbers = _floats(words[1:])
        if len(numbers) not in (3, 4, 6, 7):
            raise ValueError("three coordinates, and perhaps a weight or a colour")
        self._vertices.extend(numbers[:3])
        self._vertex_lines.append(line)
        self._totals[0] += 1
        if len(numbers) < 6:
            self._color_row.append(-1)
            return
        self._color_row.append(len(self._colors) // 3)
        self._colors.extend(numbers[3:6])

    def _texture(self, _: int, words: Sequence[bytes]) -> None:
        numbers = _floats(words[1:])
        if not 1 <= len(numbers) <= 3:
            raise ValueError("one to three texture coordinates")
        self._uv.extend((numbers[0], numbers[1] if len(numbers) > 1 else 0.0))
        self._totals[1] += 1

    def _normal(self, _: int, words: Sequence[bytes]) -> None:
        """Count it: normals are computed, but corners with several are different vertices."""
        del words
        self._totals[2] += 1

    def _face(self, line: int, words: Sequence[bytes]) -> None:
        count = len(words) - 1
        if count < 3:
            raise ValueError("a face of three or more corners")
        if len(self._corners[0]) + count > 3 * MAX_VERTICES:
            raise ValueError(f"at most {3 * MAX_VERTICES} corners of faces")
        try:
            self._indices(words[1:])
        except (ValueError, OverflowError):
            raise ValueError("a face with whole numbers v, v/vt, v//vn or v/vt/vn") from None
        lacking = self._corners[1][-count:].count(ABSENT)
        if 0 < lacking < count:
            raise ValueError("a face with texture coordinates at all corners or at none")
        group = FaceGroup(self._object, self._material, not lacking)
        self._group_of.append(self._groups.setdefault(group, len(self._groups)))
        check_parts(len(self._groups), "objects and materials: join them")
        self._counts.append(count)
        self._lines.append(line)
        self._before.extend(self._totals)

    def _indices(self, words: Sequence[bytes]) -> None:
        """Take the indices of a face's corners."""
        widths = {word.count(b"/") + 1 for word in words}
        width = widths.pop()
        joined = b" ".join(words)
        check_digits(joined)
        numbers = joined.replace(b"/", b" ").split()
        if not widths and width <= 3 and len(numbers) == width * len(words):
            for kind, into in enumerate(self._corners):
                absent = repeat(ABSENT, len(words))
                into.extend(map(int, numbers[kind::width]) if kind < width else absent)
            return
        # Corners of which some indices are left out.
        for word in words:
            first, second, third, *more = (*word.split(b"/"), b"", b"")
            if any(more):
                raise ValueError
            for into, each in zip(self._corners, (first, second, third), strict=True):
                into.append(int(each) if each or into is self._corners[0] else ABSENT)


def name_text(name: bytes) -> str:
    r"""Return a name as text that can be shown, other bytes than those of UTF-8 as numbers.

    So different names stay different, in whatever encoding.

    >>> name_text(b"M\xfcll")
    'M\\xfcll'
    """
    return name.decode("utf-8", errors="backslashreplace")


def file_name(name: bytes) -> str:
    """Return a file's name so that opening it asks for the very bytes."""
    return os.fsdecode(name)


def _floats(words: Sequence[bytes]) -> list[float]:
    try:
        check_digits(b"".join(words))
        return [float(word) for word in words]
    except ValueError:
        raise ValueError("numbers with decimal points") from None


def _integers(values: array[int]) -> NDArray[np.int64]:
    return np.frombuffer(values, np.int64) if len(values) else np.empty(0, np.int64)


def logical_lines(data: bytes) -> Iterator[tuple[int, bytes]]:
    r"""Yield each line with its number, and those joined by ``\`` as one with that of the first.

    >>> list(logical_lines(b"f 1 2 \\\r\n3\n# a \\\nv"))
    [(1, b'f 1 2  3'), (3, b'# a \\'), (4, b'v')]
    """
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    held: list[bytes] = []
    number = 0
    for number, ended in enumerate(io.BytesIO(data), 1):
        line = ended.removesuffix(b"\n")
        # A comment ends with its line: some end with a folder's name.
        if line.endswith(b"\\") and (held or not line.lstrip().startswith(b"#")):
            held.append(line[:-1])
        elif held:
            yield number - len(held), b" ".join((*held, line))
            held = []
        else:
            yield number, line
    if held:
        yield number - len(held) + 1, b" ".join(held)
