"""Radiance (``.hdr``) files: their headers, and the kinds of pixels that OpenCV does not read."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import quote
from oaisys_core.files.numbers import float_of

_LONGEST_HEADER = 65_536
_RUN = 1
"""Red, green and blue of what is no pixel but repeats the one before."""
_NEW_RUNS = (8, 32767)
"""Least and largest width of rows that are compressed channel by channel."""


class RadianceHeader(NamedTuple):
    """What the header of a Radiance (``.hdr``) file says.

    Attributes:
        width: Of the image.
        height: Of the image.
        start: Place of the pixels in the file.
        factors: By which red, green and blue were multiplied when the file was written.
        primaries: x and y of red, green and blue, if it names them.
    """

    width: int
    height: int
    start: int
    factors: tuple[float, float, float]
    primaries: tuple[float, ...] = ()


def radiance_header(data: bytes) -> RadianceHeader:
    """Return the header of a Radiance file.

    Raises:
        ValueError: It is no such file, its rows do not go from the top to the bottom, its pixels
            are not red, green and blue, or an exposure is no number above 0.
    """
    head = data[:_LONGEST_HEADER]
    found = re.match(rb"#\?[^\n]*\n(?:[^\n]+\n)*\n-Y (\d{1,9}) \+X (\d{1,9})\n", head)
    formats = [] if found is None else re.findall(rb"\nFORMAT=[ \t]*(\S*)", found[0])
    if found is None or not formats:
        raise ValueError("it is not a Radiance file with rows from the top to the bottom")
    for other in {*formats} - {b"32-bit_rle_rgbe"}:
        raise ValueError(f"its pixels are {_text(other)}, not 32-bit_rle_rgbe")
    factors = _radiance_factors(found[0])
    primaries = _primaries(found[0])
    return RadianceHeader(int(found[2]), int(found[1]), found.end(), factors, primaries)


def _primaries(head: bytes) -> tuple[float, ...]:
    """Return the last primaries that a Radiance file's header names, without the white."""
    texts = re.findall(rb"\nPRIMARIES=([^\n]*)", head)
    if not texts:
        return ()
    try:
        values = tuple(float_of(value) for value in texts[-1].split())
    except ValueError:
        values = ()
    if len(values) != 8:
        raise ValueError(f"its header says {_text(b'PRIMARIES=' + texts[-1])}")
    return values[:6]


def _radiance_factors(head: bytes) -> tuple[float, float, float]:
    """Return the product of all exposures and colour corrections in a Radiance file's header."""
    product = [1.0, 1.0, 1.0]
    for name, text in re.findall(rb"\n(EXPOSURE|COLORCORR)=([^\n]*)", head):
        try:
            values = [float_of(value) for value in text.split()]
        except ValueError:
            values = []
        if len(values) != (1 if name == b"EXPOSURE" else 3) or not all(map(_is_factor, values)):
            raise ValueError(f"its header says {_text(name + b'=' + text)}")
        of_colors = values * (3 // len(values))
        product = [all_ * each for all_, each in zip(product, of_colors, strict=True)]
    if not all(map(_is_factor, product)):
        raise ValueError(f"the exposures and colour corrections in its header make {product}")
    return product[0], product[1], product[2]


def _is_factor(value: float) -> bool:
    return 1e-30 < value < 1e30


def _text(data: bytes) -> str:
    return quote(data.decode("ascii", "replace"))


def has_new_runs(data: bytes, header: RadianceHeader) -> bool:
    """Return whether rows are compressed channel by channel, which OpenCV reads."""
    least, largest = _NEW_RUNS
    first = data[header.start : header.start + 3]
    return least <= header.width <= largest and first[:2] == b"\2\2" and first[2:] < b"\x80"


def plain_radiance(data: bytes, header: RadianceHeader) -> NDArray[np.float32]:
    """Return the (H, W, 3) pixels that are as they are, or repeated by the first kind of runs.

    Raises:
        ValueError: They are fewer than the header says, or run beyond.
    """
    wanted = header.width * header.height
    stored = np.frombuffer(data, np.uint8, offset=header.start)
    entries = stored[: min(len(stored) // 4, wanted) * 4].reshape(-1, 4)
    is_run = (entries[:, :3] == _RUN).all(axis=1)
    rgbe = _without_runs(entries, is_run, wanted) if is_run.any() else entries
    if len(rgbe) != wanted:
        raise ValueError(f"it has {len(rgbe)} pixels, not {wanted}")
    exponent = rgbe[:, 3].astype(np.int32)
    factor = np.where(exponent > 0, np.ldexp(np.float32(1), exponent - 136), 0).astype(np.float32)
    radiance = rgbe[:, :3] * factor[:, None]
    return radiance.reshape(header.height, header.width, 3)


def _without_runs(
    entries: NDArray[np.uint8], is_run: NDArray[np.bool_], wanted: int
) -> NDArray[np.uint8]:
    """Return the pixels of (N, 4) entries, of which some say how often the one before comes again.

    Of successive ones, each has the next eight bits of the number.
    """
    places = np.arange(len(entries))
    pixel_of = np.maximum.accumulate(np.where(is_run, -1, places))
    if pixel_of[0] < 0:
        raise ValueError("it begins with a run of no pixel")
    shift = 8 * np.clip(places - pixel_of - 1, 0, 4)
    counts = np.where(is_run, entries[:, 3].astype(np.int64) << shift, 1)
    ends = np.cumsum(np.minimum(counts, wanted + 1))
    used = int(np.searchsorted(ends, wanted)) + 1
    if used <= len(ends) and ends[used - 1] > wanted:
        raise ValueError(f"its runs go beyond its {wanted} pixels")
    return np.repeat(entries[pixel_of[:used]], counts[:used], axis=0)
