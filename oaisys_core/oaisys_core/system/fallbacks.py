"""Tells once in a process that a part of another library cannot be used, and what is lost."""

from __future__ import annotations

import logging
from functools import cache

_LOG = logging.getLogger(__name__)


@cache
def report_fallback(part: str, reason: object, instead: str) -> None:
    """Write a warning to the log, the first time that it is called with these words.

    Args:
        part: What cannot be used.
        reason: Why, such as an error.
        instead: What is done without it, and what is lost.
    """
    _LOG.warning("%s cannot be used (%s): %s", part, reason, instead)
