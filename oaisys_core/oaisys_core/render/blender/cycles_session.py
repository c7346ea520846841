"""Ends a render of Cycles while it takes samples.

Blender's own way to stop a render waits for the samples that Cycles has begun, and in background
mode Cycles begins as many at once as take 30 s. The function with which Cycles itself ends a
render stops between two samples of a pixel. Python has no access to it, so it is called by its
address, which the library's table of symbols gives.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from ctypes import CFUNCTYPE, c_bool, c_void_p
from functools import cache
from pathlib import Path
from threading import Thread
from typing import Any

import bpy
import numpy as np

_LOG = logging.getLogger(__name__)

KNOWN_VERSIONS = {(4, 5), (5, 2)}
"""Versions of Blender in which `SESSION_OFFSET` and the function's arguments are known."""

CANCEL_SYMBOL = b"_ZN3ccl7Session6cancelEb"
"""``ccl::Session::cancel(bool quick)``; any thread may call it while the session lives."""

SESSION_OFFSET = 8
"""Bytes from the start of a ``ccl::BlenderSession`` to its pointer to the ``ccl::Session``."""

SYMBOL_TABLE = 2
"""Type of an ELF section that holds all symbols."""

_HEADER = np.dtype([("start", "V40"), ("sections_at", "<u8"), ("flags", "V12"), ("count", "<u2")])
_SECTION = np.dtype(
    [
        ("name", "<u4"),
        ("type", "<u4"),
        ("flags", "<u8"),
        ("address", "<u8"),
        ("offset", "<u8"),
        ("size", "<u8"),
        ("link", "<u4"),
        ("info", "<u4"),
        ("alignment", "<u8"),
        ("entry_size", "<u8"),
    ]
)
_SYMBOL = np.dtype([("name", "<u4"), ("kind", "V4"), ("value", "<u8"), ("size", "<u8")])
"""Structures of 64-bit ELF files; of the file's header only the beginning."""

LOST_S = 1.0
"""Time after which a call that has not returned is taken to be lost; it takes milliseconds."""


def end_sampling(session: int) -> None:
    """Make the render that runs in a session end at once, and wait for that; on any thread.

    Between two rounds of samples, Cycles forgets the call, begins the next round, of up to 30 s,
    and lets the call wait for its end. A second call, on another thread, then ends that round.

    Nothing happens with a version of Blender where the way is not known. Call it only after Cycles
    has copied the scene: it cannot go on with one that was copied in part.

    Args:
        session: ``session`` of a ``CyclesRender`` whose ``render`` is running.
    """
    cancel = _cancel_function()
    if cancel is None:
        return
    arguments = (c_void_p.from_address(session + SESSION_OFFSET), True)
    first, second = (Thread(target=cancel, args=arguments, name="end_sampling") for _ in range(2))
    first.start()
    first.join(LOST_S)
    if first.is_alive():
        second.start()
        second.join()
    first.join()


@cache
def _cancel_function() -> Callable[[c_void_p, bool], None] | None:
    """Return ``ccl::Session::cancel``; None where it is not known."""
    library = loaded_library() if bpy.app.version[:2] in KNOWN_VERSIONS else None
    value = None if library is None else symbol_value(library[1], CANCEL_SYMBOL)
    if library is None or value is None:
        _LOG.warning("a render of Blender %s cannot be ended early", bpy.app.version_string)
        return None
    return CFUNCTYPE(None, c_void_p, c_bool)(library[0] + value)


def loaded_library() -> tuple[int, Path] | None:
    """Return the address at which Blender's library is loaded, and its file."""
    for mapping in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines():
        addresses, *_, path = mapping.split(maxsplit=5)
        if path.endswith("/bpy/__init__.so"):
            return int(addresses.partition("-")[0], 16), Path(path)
    return None


def symbol_value(library: Path, name: bytes) -> int | None:
    """Return where a symbol lies in a 64-bit ELF file's memory; None if it has no such symbol."""
    header = np.fromfile(library, _HEADER, 1)[0]
    count, offset = int(header["count"]), int(header["sections_at"])
    sections = np.fromfile(library, _SECTION, count, offset=offset)
    for table in sections[sections["type"] == SYMBOL_TABLE]:
        names = _content(library, sections[table["link"]])
        at = names.find(b"\0" + name + b"\0")
        symbols = np.frombuffer(_content(library, table), _SYMBOL)
        found = symbols["value"][symbols["name"] == at + 1]
        if at >= 0 and found.size:
            return int(found[0])
    return None


def _content(library: Path, section: Any) -> bytes:
    with library.open("rb") as file:
        file.seek(int(section["offset"]))
        return file.read(int(section["size"]))
