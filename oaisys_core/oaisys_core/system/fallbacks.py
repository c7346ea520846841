"""Tells once in a process that a part of another library cannot be used, and what is lost."""

from __future__ import annotations

from functools import cache


@cache
def report_fallback(part: str, reason: str, instead: str) -> None:
    """Write a warning to the log, the first time that it is called with these words.

    Args:
        part: What cannot be used.
        reason: Why, such as the text of an error.
        instead: What is done without it, and what is lost.
    """
    import logging  # not before it is needed: whatever imports the core imports this

    logging.getLogger(__name__).warning("%s cannot be used (%s): %s", part, reason, instead)
