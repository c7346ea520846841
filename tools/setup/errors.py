"""Errors of the set-up."""

from __future__ import annotations


class SetupError(Exception):
    """The set-up cannot continue; the message is the line that the user sees."""


class OptionalStepError(SetupError):
    """An optional step failed; the next set-up tries it again."""
