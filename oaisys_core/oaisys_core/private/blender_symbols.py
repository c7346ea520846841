"""Addresses of symbols in Blender's library that its table of symbols names, but does not export.

Private part: the table of all symbols of ``bpy/__init__.so``, which a stripped library has not.
Tried with: bpy 4.5.15 and 5.2.3.
Public way without it: that of the modules that ask for a symbol, which get None.
Lost without it: see `cycles_session` and `cycles_log`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

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


def symbol_address(name: bytes) -> int | None:
    """Return where a symbol of Blender's library lies in this process; None: there is none."""
    try:
        library = _find_library()
        value = None if library is None else _symbol_value(library[1], name)
    except OSError:  # a system without /proc
        return None
    return None if library is None or value is None else library[0] + value


def _find_library() -> tuple[int, Path] | None:
    """Return the address at which Blender's library is loaded, and its file."""
    for mapping in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines():
        addresses, *_, path = mapping.split(maxsplit=5)
        if path.endswith("/bpy/__init__.so"):
            return int(addresses.partition("-")[0], 16), Path(path)
    return None


def _symbol_value(library: Path, name: bytes) -> int | None:
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
