"""Checks of COLLADA files: what Blender's importer would leave out without a word."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree as ET
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import quote
from oaisys_core.files.numbers import float_of

SHAPES = ("triangles", "tristrips", "trifans", "polylist", "polygons")
"""Elements with the indices of surfaces."""

LOOKED_UP = ("VERTEX", "TEXCOORD", "COLOR")
"""What indices are read of; normals are computed."""

MOST_DIGITS = 9
"""Of a stride or an offset."""

LARGE = ("geometry", "animation", "controller")
"""Elements that are let go once they were looked at."""


class ColladaText:
    """What a COLLADA file says of its unit and its images.

    Attributes:
        images: The addresses of its images, as written, each once.
    """

    def __init__(self, path: Path) -> None:
        """Read a file.

        Raises:
            ValueError: Its unit is not above 0, or an index leads beyond what there is.
            ET.ParseError: It is not XML, or in an encoding that is not read.
        """
        self.images: dict[str, None] = {}
        self._open: list[str] = []
        for event, element in _events(path):
            if event == "start":
                self._open.append(_tag(element))
                continue
            if self._open == ["COLLADA", "asset", "unit"]:
                _check_unit(element.get("meter", "1"))
            self._take(self._open.pop(), element)

    def _take(self, tag: str, element: Element) -> None:
        if tag == "image":
            found = (child.text for child in element if _tag(child) == "init_from")
            self.images |= {text.strip(): None for text in found if text and text.strip()}
        elif tag == "mesh":
            _check_mesh(element)
        elif tag in LARGE:
            element.clear()

    def references(self, folder: Path) -> Iterator[tuple[str, Path]]:
        """Yield the images, as written and as a path, for a file in a folder."""
        for written in self.images:
            plain = unquote(written).replace("\\", "/").removeprefix("file://")
            yield written.removeprefix("file://"), folder / plain


def _events(path: Path) -> Iterator[tuple[str, Element]]:
    try:
        # The reader's process is bounded in memory and time, and expat in what entities unfold.
        yield from ET.iterparse(path, ("start", "end"))  # noqa: S314
    except (LookupError, ValueError) as error:  # of encodings
        raise ET.ParseError(str(error)) from error


def _tag(element: Element) -> str:
    """Return an element's name without its namespace."""
    return str(element.tag).rpartition("}")[2]


def _check_unit(meter: str) -> None:
    try:
        value = float_of(meter)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise ValueError(f"a <unit> with a meter above 0, not {quote(meter)}")


def _check_mesh(mesh: Element) -> None:
    """Raise if an index of a surface leads beyond the vertices, or other rows, of its mesh."""
    rows = {f"#{source.get('id')}": _rows(source) for source in mesh if _tag(source) == "source"}
    for vertices in (child for child in mesh if _tag(child) == "vertices"):
        for each in vertices:
            if each.get("semantic") == "POSITION" and (source := each.get("source", "")) in rows:
                rows[f"#{vertices.get('id')}"] = rows[source]
    for shape in (child for child in mesh if _tag(child) in SHAPES):
        _check_shape(shape, rows)


def _rows(source: Element) -> int:
    """Return how many rows of numbers a source has, whatever its counts announce."""
    numbers = next((each for each in source if _tag(each) == "float_array"), None)
    accessor = next((each for each in source.iter() if _tag(each) == "accessor"), None)
    stride = 1 if accessor is None else _whole(accessor, "stride", 1)
    return 0 if numbers is None else len((numbers.text or "").split()) // stride


def _check_shape(shape: Element, rows: Mapping[str, int]) -> None:
    inputs = [each for each in shape if _tag(each) == "input"]
    offsets = [_whole(each, "offset", 0) for each in inputs]
    width = 1 + max(offsets, default=0)
    for text in (each.text or "" for each in shape.iter() if _tag(each) in ("p", "h")):
        indices = _integers(text)
        for each, offset in zip(inputs, offsets, strict=True):
            count = rows.get(each.get("source", ""))
            own = indices[offset::width]
            if count is None or each.get("semantic") not in LOOKED_UP or not len(own):
                continue
            bad = own[(own < 0) | (own >= count)]
            if len(bad):
                what = f"indices of {each.get('semantic')} from 0 to {count - 1}"
                raise ValueError(f"{what} in <{_tag(shape)}>, not {bad[0]}")


def _whole(element: Element, name: str, least: int) -> int:
    """Return a whole number in an attribute, by default the least that it may be."""
    text = element.get(name, str(least))
    if not text.isdecimal() or len(text) > MOST_DIGITS or int(text) < least:
        raise ValueError(f"{name} of {least} or more in <{_tag(element)}>, not {quote(text)}")
    return int(text)


def _integers(text: str) -> NDArray[np.int64]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(text, np.int64, sep=" ")
        except DeprecationWarning:
            raise ValueError("whole numbers as indices") from None
