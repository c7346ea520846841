"""Heights in text files, of which each word is checked: GDAL reads what is no number as 0."""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError, quote
from oaisys_core.types import FloatArray

_NUMBER = rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_WORD = re.compile(rb"(?<!\S)(?!(?:%s|(?i:nan|[+-]?inf))(?!\S))\S+" % _NUMBER)
"""Among heights: what is not one."""

_NO_NUMBER_OF_WINDOWS = re.compile(rb"[+-]?1\.#\w+")
"""NaN and infinity, as programs for Windows print them."""

_ARC_INFO_HEAD = re.compile(
    rb"(?:\s*(?:ncols|nrows|[xy]ll(?:corner|center)|cellsize|dx|dy|nodata_value)\s+\S+)*", re.I
)
_GRASS_HEAD = re.compile(rb"(?:[ \t]*[a-z]+:[^\n]*\n|\s*\n)*", re.I)
_HEADS = {
    "AAIGrid": _ARC_INFO_HEAD,
    "GRASSASCIIGrid": _GRASS_HEAD,
    "ISG": re.compile(rb".*?^end_of_head[^\n]*\n", re.I | re.S | re.M),
    "GSAG": re.compile(rb"DSAA(?:\s+\S+){8}"),
    "GXF": re.compile(rb".*?^#GRID[^\n]*\n", re.I | re.S | re.M),
    "ZMap": re.compile(rb".*?^@[ \t]*\r?\n", re.S | re.M),
}
"""What stands before the heights, by GDAL's drivers of grids that are texts."""

_WORD_OF_ZMAP = re.compile(rb"\S*[^-+.\deE\s]\S*")
"""Its numbers have a width, and may stand without blanks between them."""

_PACKED = re.compile(rb"^#GTYPE?\s+[1-9]", re.I | re.M)
"""In the head of a GXF file whose numbers are letters."""

_END = 8.6420e307
"""Follows the heights: it is only reached if all of them are numbers."""

_VOID = re.compile(rb"(?:nodata_value[ \t]|^\s*null:)[ \t]*(\S+)", re.I | re.M)
_MULTIPLIER = re.compile(rb"^\s*multiplier:[ \t]*(\S+)", re.I | re.M)

_POINT = re.compile(rb"^[ \t,;]*[-+.\d]", re.M)
"""Beginning of a line of an XYZ file that is no header."""


def read_text_heights(data: bytes, file: Any, field: str) -> FloatArray | None:
    """Return the heights of a grid in a text file; None if GDAL reads them, of GXF and ZMap too.

    Args:
        data: The file.
        file: Dataset of rasterio that says its format and size.
        field: Name of the configuration field in errors.

    Returns:
        (rows, cols) as stored, the north first; NaN where a word says that there is none.

    Raises:
        InvalidInputError: It has other words, or more or fewer heights than its size says.
    """
    pattern = _HEADS.get(file.driver)
    if pattern is None:
        return None
    found = pattern.match(data)
    start = 0 if found is None else found.end()
    head, body = data[:start], data[start:]
    if file.driver == "ZMap":
        _check_word(_WORD_OF_ZMAP.search(body), field)
        return None
    if file.driver == "GXF":  # whose head says in which order they are
        if not _PACKED.search(head):
            _numbers(_with_nan(body, None), file.shape, field)
        return None
    multiplier = _MULTIPLIER.search(head) if file.driver == "GRASSASCIIGrid" else None
    if multiplier is not None and _number(multiplier[1]) != 1:
        received = f"a multiplier of {_shown(multiplier[1])}"
        raise InvalidInputError(f"{field}.file", received, "heights with a multiplier of 1")
    void = _VOID.search(head)
    heights = _numbers(_with_nan(body, void and void[1]), file.shape, field)
    number = file.nodata if void is None else _number(void[1])
    if number is not None:
        heights[heights == number] = np.nan
    grid = heights.reshape(file.shape)
    return grid[::-1] if file.driver == "GSAG" else grid


def check_points(data: bytes, file: Any, field: str) -> None:
    """Raise `InvalidInputError` if an XYZ file lacks points that GDAL would fill with 0.

    Args:
        data: The file.
        file: Dataset of rasterio; where it has a void, lacking points are that.
        field: Name of the configuration field in errors.
    """
    if file.driver != "XYZ" or file.nodata is not None:
        return
    rows, cols = file.shape
    count = sum(1 for _ in _POINT.finditer(data))
    if count != rows * cols:
        expected = (
            f"{rows * cols} ({cols} columns x {rows} rows); write each missing one with a height"
            f" of -9999, and {field}.nodata: -9999"
        )
        raise InvalidInputError(f"{field}.file", f"{count} points", expected)


def _with_nan(body: bytes, void: bytes | None) -> bytes:
    """Return a text whose numbers all have a point, and whose words for voids are ``nan``."""
    text = body.rstrip(b"\0\x1a \t\r\n")
    for other, usual in ((b",", b"."), (b"*", b" nan ")):
        text = text.replace(other, usual) if other in text else text
    if b"#" in text:
        text = _NO_NUMBER_OF_WINDOWS.sub(b"nan", text)
    if void is not None and _number(void) is None:
        text = re.sub(rb"(?<!\S)%s(?!\S)" % re.escape(void), b"nan", text)
    return text


def _numbers(text: bytes, shape: tuple[int, int], field: str) -> FloatArray:
    """Return the numbers between blanks, as many as a grid of this shape has."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of a word, at which it stops
        try:
            found = np.fromstring(text + b" %r" % _END, np.float64, sep=" ")
        except ValueError:  # as newer versions say it
            found = np.empty(0)
    rows, cols = shape
    is_whole = len(found) > 0 and found[-1] == _END
    if is_whole and len(found) == rows * cols + 1:
        return np.asarray(found[:-1])
    if not is_whole:
        _check_word(_WORD.search(text), field)
    expected = f"{rows * cols} ({cols} columns x {rows} rows), as its header says"
    raise InvalidInputError(f"{field}.file", f"{len(text.split())} heights", expected)


def _check_word(word: re.Match[bytes] | None, field: str) -> None:
    if word is not None:
        expected = "a number, or for a void the value that the header names"
        raise InvalidInputError(f"{field}.file", f"the height {_shown(word[0])}", expected)


def _number(word: bytes) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


def _shown(word: bytes) -> str:
    return quote(word.decode("ascii", "replace"))
