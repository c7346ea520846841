"""What Cycles logs as an error while it renders.

Cycles goes on after some errors, for instance with a shader that does not fit its stack, which is
black then, and Blender reports nothing of them to Python. Both ways of logging are replaced for the
time of a render by functions that pass everything on at once, before they note it, so that the log
of a process that crashes is complete.

Private part: ``ccl::LOG_FUNCTION``, through which Cycles of Blender 5 logs, by its symbol; and the
    lines that Cycles of Blender 4.5 prints to ``stderr`` of the C library, which is replaced.
Tried with: bpy 4.5.15 and 5.2.3, glibc 2.36.
Public way without it: `oaisys_core.render.blender.ground_check` finds ground that is black.
Lost without it: objects whose material is black, because it does not fit, are delivered.
"""

from __future__ import annotations

import ctypes
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from ctypes import CFUNCTYPE, c_char_p, c_int, c_size_t, c_ssize_t, c_void_p
from functools import cache
from typing import Any, Protocol

from oaisys_core.private.blender_symbols import symbol_address
from oaisys_core.system.fallbacks import report_fallback

LOG_SYMBOL = b"_ZN3cclL12LOG_FUNCTIONE"
"""``ccl::LOG_FUNCTION``: which function Cycles of Blender 5 logs with."""

FIRST_WITH_FUNCTION = 5
"""Blender's first major version that logs with that function."""

MILDEST_ERROR = 3
"""``ccl::LOG_LEVEL_DERROR``; fatal errors have a lower level, warnings have higher ones."""

PRINTED_ERROR = re.compile(rb"^(?:Cycles: |[EF]\d{4} [\d:.]+ +\d+ [^ ]+:\d+\] )(.+)", re.MULTILINE)
"""Error as Cycles of Blender 4.5 prints it: by itself, or by glog (whose warnings begin with W)."""

ERROR_STREAM = "stderr"
"""The C library's name of the stream to which Cycles of Blender 4.5 prints."""

STANDARD_ERROR = 2
UNBUFFERED = 2
"""``_IONBF`` of ``setvbuf``."""

_Log = CFUNCTYPE(None, c_int, c_char_p, c_char_p, c_char_p)
"""``ccl::LogFunction``: level, file and line, function, message."""

_Write = CFUNCTYPE(c_ssize_t, c_void_p, c_void_p, c_size_t)
"""``cookie_write_function_t``: returns how many bytes were taken."""


class _CookieFunctions(ctypes.Structure):
    """``cookie_io_functions_t`` of ``fopencookie``."""

    _fields_ = (("read", c_void_p), ("write", _Write), ("seek", c_void_p), ("close", c_void_p))


class _Channel(Protocol):
    """Where Cycles writes its errors.

    Attributes:
        slot: A pointer in this process that says where.
        own: Its value while errors are noted.
        errors: Receives the errors.
    """

    slot: c_void_p
    own: int
    errors: list[str]


@contextmanager
def collect_errors(version: tuple[int, ...]) -> Iterator[list[str]]:
    """Yield a list to which the errors are added that Cycles logs during the block.

    Args:
        version: ``bpy.app.version``.
    """
    channel = _channel(version[0])
    if channel is None:
        yield []
        return
    before, channel.errors = channel.slot.value, []
    channel.slot.value = channel.own
    try:
        yield channel.errors
    finally:
        channel.slot.value = before


@cache
def _channel(major: int) -> _Channel | None:
    """Return where Cycles of this Blender writes its errors; None where that is not known."""
    try:
        if major < FIRST_WITH_FUNCTION:
            return _ErrorStream(ctypes.CDLL(None))
        address = symbol_address(LOG_SYMBOL)
        if address is not None:
            return _LogFunction(c_void_p.from_address(address))
        reason: object = f"Blender {major} has no symbol {LOG_SYMBOL.decode()}"
    except (AttributeError, ValueError, OSError) as error:  # another C library
        reason = error
    instead = "of shaders that fail, only those of the ground are noticed, because it is black"
    report_fallback("Cycles' log", reason, instead)
    return None


class _LogFunction:
    """The function that Cycles of Blender 5 logs with."""

    def __init__(self, slot: c_void_p) -> None:
        self.slot = slot
        self.errors: list[str] = []
        self._pass_on = _Log(slot.value) if slot.value else None
        self._function = _Log(self._log)
        self.own = ctypes.cast(self._function, c_void_p).value or 0

    def _log(self, level: int, place: bytes, function: bytes, message: bytes) -> None:
        if self._pass_on is not None:
            self._pass_on(level, place, function, message)
        else:
            _print(message + b"\n")
        if level <= MILDEST_ERROR:
            self.errors.append(message.decode(errors="replace").strip())


class _ErrorStream:
    """The stream of the C library to which Cycles of Blender 4.5 prints."""

    def __init__(self, library: Any) -> None:
        """Make the stream that is used instead, without a buffer.

        Raises:
            AttributeError, ValueError: The C library has no such streams.
            OSError: It could not make one.
        """
        self.slot = c_void_p.in_dll(library, ERROR_STREAM)
        self.errors: list[str] = []
        self._write = _Write(self._note_written)
        library.fopencookie.restype = c_void_p
        library.fopencookie.argtypes = (c_void_p, c_char_p, _CookieFunctions)
        stream = library.fopencookie(None, b"w", _CookieFunctions(write=self._write))
        if not stream:
            raise OSError("the C library could not make a stream")
        library.setvbuf(c_void_p(stream), None, UNBUFFERED, c_size_t(0))
        self.own = int(stream)

    def _note_written(self, _cookie: int | None, at: int, size: int) -> int:
        text = ctypes.string_at(at, size)
        _print(text)
        found = PRINTED_ERROR.findall(text)
        self.errors += [each.decode(errors="replace").strip() for each in found]
        return size


def _print(text: bytes) -> None:
    """Write to standard error, which may be closed, as the C library does."""
    with suppress(OSError):
        while text:
            text = text[os.write(STANDARD_ERROR, text) :]
