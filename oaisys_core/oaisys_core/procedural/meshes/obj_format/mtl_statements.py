"""The statements of .mtl files that are read, as the format's specification says."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from oaisys_core.errors import quote
from oaisys_core.files.documents import wide_encoding
from oaisys_core.files.numbers import float_of
from oaisys_core.procedural.meshes.obj_format.obj_statements import (
    file_name,
    logical_lines,
    name_text,
)

READ = frozenset((b"kd", b"d", b"tr", b"map_kd", b"map_d"))

LEFT_OUT = frozenset(
    (
        *(b"ka", b"ks", b"ke", b"tf", b"illum", b"ns", b"ni", b"sharpness", b"map_ka", b"map_ks"),
        *(b"map_ke", b"map_ns", b"map_aat", b"map_bump", b"bump", b"disp", b"map_disp", b"refl"),
        *(b"map_refl", b"norm", b"map_norm", b"pr", b"pm", b"ps", b"pc", b"pcr", b"aniso"),
        *(b"anisor", b"map_pr", b"map_pm", b"map_ps", b"map_tf", b"map_ni"),
    )
)
"""Statements about light, and small relief, which are never read."""

ARITY = {b"-o": 3, b"-s": 3, b"-t": 3, b"-mm": 2}
"""Options of maps with so many numbers at most; all others have one value."""

SAME = frozenset((b"-blendu", b"-blendv", b"-bm", b"-boost", b"-cc", b"-texres", b"-type"))
"""Options that neither move an image nor change its colours here."""

TOLERANCE = 0.001
"""Some numbers are rounded up in their last digit."""


class TextureMap(NamedTuple):
    """A map: its file, where it stands, and how its image lies on a mesh.

    Attributes:
        file: Its name, as `os.fsdecode` decodes bytes.
        where: The .mtl file and the line, for errors.
        scale, offset: By which texture coordinates are multiplied, then moved.
        is_clamped: Whether the image does not repeat.
        channel: Of ``-imfchan``: r, g, b, m (matte) or l (luminance); empty if it does not say.
        unread: Options with an effect that is left out.
    """

    file: str
    where: str
    scale: tuple[float, float]
    offset: tuple[float, float]
    is_clamped: bool
    channel: str
    unread: tuple[str, ...]

    @property
    def place(self) -> tuple[object, ...]:
        """What says where the image lies."""
        return (self.scale, self.offset, self.is_clamped)


class MtlMaterial:
    """What a .mtl file says about a material: its last statement of each kind."""

    def __init__(self, where: str) -> None:
        """Begin with nothing; ``where`` is the file, for errors."""
        self._where = where
        self._statements: dict[bytes, tuple[int, bytes]] = {}

    def add(self, line: int, key: bytes, value: bytes) -> None:
        """Take a statement by its lower-case keyword."""
        self._statements[key] = (line, value)

    def color(self) -> tuple[float, float, float] | None:
        """Return ``Kd``; None: there is none.

        Raises:
            ValueError: It is anything but numbers from 0 to 1; with file and line.
        """
        found = self._numbers(b"kd", (1, 3), "a Kd of one or three numbers from 0 to 1")
        if found is None:
            return None
        red, green, blue = found if len(found) == 3 else found * 3
        return (red, green, blue)

    def dissolve(self) -> float:
        """Return ``d``, else what ``Tr`` leaves, else 1.

        Raises:
            ValueError: It is anything but a number from 0 to 1; with file and line.
        """
        found = self._numbers(b"d", (1,), "a d of a number from 0 to 1")
        if found is not None:
            return found[0]
        found = self._numbers(b"tr", (1,), "a Tr of a number from 0 to 1")
        return 1.0 if found is None else 1.0 - found[0]

    def texture(self, key: bytes) -> TextureMap | None:
        """Return the map of a keyword; None: there is none, or without a file.

        Raises:
            ValueError: An option that is read has another value than the specification allows.
        """
        line, value = self._statements.get(key, (0, b""))
        return _texture(value, f"{self._where}, line {line}") if value else None

    def _numbers(self, key: bytes, counts: Sequence[int], what: str) -> tuple[float, ...] | None:
        if key not in self._statements:
            return None
        line, value = self._statements[key]
        words = value.partition(b"#")[0].split()
        if key == b"d" and words[:1] == [b"-halo"]:
            words = words[1:]
        found = [_number(word) for word in words]
        if len(found) not in counts or not all(-TOLERANCE <= n <= 1 + TOLERANCE for n in found):
            shown = quote(name_text(value))
            raise ValueError(f"{what}, not {shown}: {self._where}, line {line}")
        return tuple(min(max(number, 0.0), 1.0) for number in found)


class MtlStatements:
    """What a .mtl file says.

    Attributes:
        file: Its name, for messages.
        materials: By their names.
        repeated: Names that come again; the last material of a name counts.
        unknown: Keywords that are not read, as the specification does not have them.
    """

    def __init__(self, data: bytes, file: str) -> None:
        """Read a file's content; ``file`` names it in errors.

        Raises:
            ValueError: It is in UTF-16 or UTF-32.
        """
        if (encoding := wide_encoding(data)) is not None:
            raise ValueError(f"materials in UTF-8, not {encoding}: {file}")
        self.file = file
        self.materials: dict[str, MtlMaterial] = {}
        self.repeated: dict[str, None] = {}
        self.unknown: dict[str, None] = {}
        current = MtlMaterial(file)
        for line, text in logical_lines(data):
            key, value = _split(text)
            if key == b"newmtl":
                name = name_text(value)
                if name in self.materials:
                    self.repeated[name] = None
                current = self.materials[name] = MtlMaterial(file)
            elif key in READ:
                current.add(line, key, value)
            elif key and not key.startswith(b"#") and key not in LEFT_OUT:
                self.unknown[name_text(key)] = None


def _split(text: bytes) -> tuple[bytes, bytes]:
    """Return the lower-case keyword of a line, and what stands behind it."""
    words = text.split(maxsplit=1)
    return words[0].lower() if words else b"", words[1].strip() if len(words) > 1 else b""


def _texture(value: bytes, where: str) -> TextureMap:
    """Return a map's file, whose name may contain spaces, and the options before it."""
    words = list(re.finditer(rb"\S+", value))
    options: dict[bytes, list[bytes]] = {}
    at = 0
    while at < len(words) - 1 and words[at][0].startswith(b"-"):
        key = words[at][0].lower()
        at += 1
        first = at
        # The last word is always the file's.
        while at < min(first + ARITY.get(key, 1), len(words) - 1):
            if at > first and not math.isfinite(_number(words[at][0])):
                break
            at += 1
        options[key] = [word[0] for word in words[first:at]]
    scale = _pair(options, b"-s", 1.0, where)
    offset = _pair(options, b"-o", 0.0, where)
    return TextureMap(
        file_name(value[words[at].start() :]),
        where,
        scale,
        offset,
        _choice(options, b"-clamp", ("off", "on"), where) == "on",
        _choice(options, b"-imfchan", ("", "r", "g", "b", "m", "l"), where),
        tuple(name_text(key) for key, words in options.items() if _has_effect(key, words)),
    )


def _pair(
    options: Mapping[bytes, Sequence[bytes]], key: bytes, default: float, where: str
) -> tuple[float, float]:
    words = options.get(key)
    numbers = [default] if words is None else [_number(word) for word in words]
    if not numbers or not all(map(math.isfinite, numbers)):
        shown = quote(name_text(b" ".join(words or ())))
        raise ValueError(f"{key.decode()} with one to three numbers, not {shown}: {where}")
    return (numbers[0], numbers[1] if len(numbers) > 1 else default)


def _choice(
    options: Mapping[bytes, Sequence[bytes]], key: bytes, allowed: Sequence[str], where: str
) -> str:
    """Return the word of an option, the first of those allowed if it is not there."""
    if key not in options:
        return allowed[0]
    word = name_text(b" ".join(options[key])).lower()
    if word not in allowed or not word:
        expected = ", ".join(filter(None, allowed))
        raise ValueError(f"{key.decode()} with one of {expected}, not {quote(word)}: {where}")
    return word


def _has_effect(key: bytes, words: Sequence[bytes]) -> bool:
    """Return whether an option that is not read changes what one sees."""
    if key in (b"-s", b"-o", b"-clamp", b"-imfchan") or key in SAME:
        return False
    neutral = {b"-mm": [0.0, 1.0], b"-t": [0.0] * len(words)}
    return [_number(word) for word in words] != neutral.get(key)


def _number(word: bytes) -> float:
    """Return a number; NaN if it is none."""
    try:
        return float_of(word)
    except ValueError:
        return math.nan
