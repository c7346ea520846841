"""The errors of set-up."""

from __future__ import annotations


class SetupError(Exception):
    """Set-up cannot go on; the message is the one line that the user gets to see."""


class OptionalStepError(SetupError):
    """A step failed that the project can do without; the next set-up tries it again."""
