"""A figure of the audit of light."""

from __future__ import annotations

from dataclasses import dataclass

LIMIT = 0.01
"""Largest relative error of radiance."""


@dataclass(frozen=True)
class LightFigure:
    """A measured figure and what a formula says.

    Attributes:
        name: What was measured.
        measured, expected: In the unit that the name says; scene units if it says none.
        limit: Largest relative error that is allowed.
    """

    name: str
    measured: float
    expected: float
    limit: float = LIMIT

    @property
    def error(self) -> float:
        """Relative error."""
        return self.measured / self.expected - 1

    @property
    def is_met(self) -> bool:
        """Whether the error is within the limit; a figure that is no number is not."""
        return abs(self.error) <= self.limit
