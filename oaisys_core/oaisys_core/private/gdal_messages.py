"""What GDAL says of pixels that it reads, also where it delivers some that are damaged.

Private part: the logger ``rasterio._err``, to which rasterio writes what GDAL signals while it
    opens a file or reads pixels: errors at the level of INFO, warnings at their own.
Tried with: rasterio 1.4.4.
Public way without it: the exceptions of rasterio, for what GDAL says that it could not read.
Lost without it: damage that GDAL tells of, but delivers pixels nevertheless.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec

from oaisys_core.errors import one_line
from oaisys_core.system.fallbacks import report_fallback

LOGGER = "rasterio._err"
_ERROR = "GDAL signalled an error"
"""Beginning of a message about an error; an exception follows where GDAL delivers nothing."""


@dataclass
class GdalMessages:
    """The texts of errors and of warnings, each in a line."""

    errors: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


_listening: ContextVar[GdalMessages | None] = ContextVar("gdal_messages", default=None)


@contextmanager
def gdal_messages() -> Iterator[GdalMessages]:
    """Collect what GDAL says in this thread within the block."""
    _watch_logger()
    found = GdalMessages()
    token = _listening.set(found)
    try:
        yield found
    finally:
        _listening.reset(token)


@cache
def _watch_logger() -> None:
    if find_spec(LOGGER) is None:
        instead = "damaged pixels are refused only where GDAL delivers none"
        report_fallback("rasterio's log of GDAL's errors", f"there is no {LOGGER}", instead)
        return
    logger = logging.getLogger(LOGGER)
    logger.addFilter(_note)
    logger.setLevel(logging.INFO)


def _note(record: logging.LogRecord) -> bool:
    """Note a message; return whether it is logged, as it was without this filter."""
    found = _listening.get()
    if found is not None:
        # The text is the last of what rasterio formats.
        last = record.args[-1] if isinstance(record.args, tuple) and record.args else ""
        text = one_line(str(last))
        is_error = record.levelno >= logging.ERROR or str(record.msg).startswith(_ERROR)
        if is_error:
            found.errors.append(text)
        elif record.levelno == logging.WARNING:
            found.warnings.append(text)
    return record.levelno >= logging.getLogger("rasterio").getEffectiveLevel()
