"""Checks of mesh files that are text, row by row: what is announced or begun must be there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from oaisys_core.errors import quote
from oaisys_core.files.numbers import float_of

_RANGES = {
    **dict.fromkeys((b"char", b"int8"), (-(2**7), 2**7 - 1)),
    **dict.fromkeys((b"uchar", b"uint8"), (0, 2**8 - 1)),
    **dict.fromkeys((b"short", b"int16"), (-(2**15), 2**15 - 1)),
    **dict.fromkeys((b"ushort", b"uint16"), (0, 2**16 - 1)),
    **dict.fromkeys((b"int", b"int32"), (-(2**31), 2**31 - 1)),
    **dict.fromkeys((b"uint", b"uint32"), (0, 2**32 - 1)),
}
"""The whole numbers that a type of a .ply file holds."""

MAX_PARTS = 4096
"""Parts of a file, which each cost up to a millisecond: solids, groups, instances, libraries."""

Range = tuple[int, int]


class _Property(NamedTuple):
    is_list: bool
    values: Range | None
    """The range of whole numbers; None: any numbers."""


class _Element(NamedTuple):
    name: str
    rows: int
    properties: tuple[_Property, ...]


def check_ply_text(path: Path, start: bytes) -> None:
    """Raise if a text lacks rows that its header announces, has more, or other ones.

    Args:
        path: The file.
        start: Its begin, with the whole header.

    Raises:
        ValueError: What is expected and found, with the line.
    """
    elements = list(_elements(start))
    total = sum(element.rows for element in elements)
    with path.open("rb") as file:
        rows = enumerate(file, 1)
        for _, row in rows:
            if row.strip() == b"end_header":
                break
        for element in elements:
            for index in range(element.rows):
                line, row = next(rows, (0, b""))
                if not line:
                    announced = f"{element.rows} rows of the element {element.name}"
                    raise ValueError(f"{announced}, not {index} (is it truncated?)")
                _check_row(row.split(), element, line)
        for line, row in rows:
            if row.strip():
                expected = f"the {total} rows that its header announces, not more"
                raise ValueError(f"{expected}: line {line}")


def _elements(start: bytes) -> Iterator[_Element]:
    """Yield the elements of a header whose counts have been checked."""
    name, rows = "", 0
    properties: list[_Property] = []
    for line in start.splitlines():
        words = line.split()
        if words[:1] in ([b"element"], [b"end_header"]):
            if name:
                yield _Element(name, rows, tuple(properties))
            if words[0] == b"end_header":
                return
            name, rows, properties = words[1].decode(), int(words[2]), []
        elif words[:1] == [b"property"]:
            is_list = words[1] == b"list"
            properties.append(_Property(is_list, _RANGES.get(words[3 if is_list else 1])))


def _check_row(words: Sequence[bytes], element: _Element, line: int) -> None:
    """Raise if a row does not have the numbers of its element's properties."""
    numbers = [_number(word, line) for word in words]
    at = 0
    for each in element.properties:
        length = 1
        if each.is_list:
            length = int(numbers[at]) if at < len(numbers) and numbers[at] >= 0 else 0
            at += 1
        if each.values is not None:
            least, most = each.values
            for value in numbers[at : at + length]:
                if not (least <= value <= most and value == int(value)):
                    expected = f"whole numbers from {least} to {most} in {element.name}"
                    raise ValueError(f"{expected}, not {value:g}: line {line}")
        at += length
    if at != len(numbers):
        expected = f"{at} numbers in a row of the element {element.name}"
        raise ValueError(f"{expected}, not {len(numbers)}: line {line}")


def _number(word: bytes, line: int) -> float:
    try:
        return float_of(word)
    except ValueError:
        shown = quote(word.decode("utf-8", errors="replace"))
        raise ValueError(f"numbers, not {shown}: line {line}") from None


_NEXT = {
    "": ("solid",),
    "solid": ("facet", "endsolid"),
    "facet": ("outer",),
    "outer": ("vertex 1",),
    "vertex 1": ("vertex 2",),
    "vertex 2": ("vertex 3",),
    "vertex 3": ("endloop",),
    "endloop": ("endfacet",),
    "endfacet": ("facet", "endsolid"),
    "endsolid": ("solid",),
}
"""What may follow each line of a .stl file; three vertices are counted."""

_WORDS = frozenset(word.partition(" ")[0] for word in _NEXT)


def check_stl_text(path: Path) -> None:
    """Raise if a text has a solid, facet or loop that is not whole, or too many solids.

    Raises:
        ValueError: What is expected and found, with the line.
    """
    state, line, solids = "", 0, 0
    with path.open("rb") as file:
        for line, row in enumerate(file, 1):
            words = row.split()
            word = words[0].lower().decode("latin-1") if words else ""
            # Some exporters write colours between facets.
            if not word or (word not in _WORDS and state not in ("", "endsolid")):
                continue
            following = next((each for each in _NEXT[state] if each.split()[0] == word), None)
            if following is None:
                allowed = " or ".join(each.split()[0] for each in _NEXT[state])
                raise ValueError(f"{allowed} after {state or 'nothing'}, not {word}: line {line}")
            if word == "solid":
                solids += 1
                check_parts(solids, f"solids (line {line}): join them")
            if word == "vertex":
                if len(words) != 4:
                    raise ValueError(f"three coordinates of a vertex: line {line}")
                for number in words[1:]:
                    _number(number, line)
            state = following
    if state != "endsolid":
        expected = f"{' or '.join(_NEXT[state])} after {state}"
        raise ValueError(f"{expected}, not its end in line {line} (is it truncated?)")


def check_parts(count: int, what: str) -> None:
    """Raise if a file has too many parts of a kind.

    Raises:
        ValueError: With the bound, and what they are.
    """
    if count > MAX_PARTS:
        raise ValueError(f"at most {MAX_PARTS} {what}")
