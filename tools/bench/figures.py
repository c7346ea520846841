"""Figures: measured values with median, range and goal."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any


@dataclass(frozen=True)
class Goal:
    """A bound for a figure's median.

    Attributes:
        limit: In the figure's unit.
        at_least: Whether the limit is a lower bound.
    """

    limit: float
    at_least: bool = False

    def is_met(self, value: float) -> bool:
        """Return whether a value is on the right side of the limit."""
        return value >= self.limit if self.at_least else value <= self.limit

    def __str__(self) -> str:
        return f"{'≥' if self.at_least else '≤'} {self.limit:g}"


@dataclass(frozen=True)
class Figure:
    """Values of one quantity, measured in one run.

    Attributes:
        name: Lower case with underscores, unique in a run.
        unit: ``s``, ``ms``, ``dB``, ``MB``, ``%`` or ``x`` (a ratio); empty for a pure number.
        values: At least one, none of them NaN.
        goal: For the median; None: none.
        note: Remark in the table.
        curve, x: Name of the growth curve that the figure belongs to, and its place on it.
    """

    name: str
    unit: str
    values: tuple[float, ...]
    goal: Goal | None = None
    note: str = ""
    curve: str = ""
    x: float = 0.0

    def __post_init__(self) -> None:
        """Refuse values without a median."""
        if not self.values or any(math.isnan(value) for value in self.values):
            raise ValueError(f"{self.name}: received {self.values}, expected numbers, at least one")

    @property
    def median(self) -> float:
        """The median of the values."""
        return float(median(self.values))

    @property
    def is_met(self) -> bool | None:
        """Whether the goal is met; None without a goal."""
        return None if self.goal is None else self.goal.is_met(self.median)

    def to_dict(self) -> dict[str, Any]:
        """Return the record for ``bench.json``."""
        record: dict[str, Any] = {
            "name": self.name,
            "unit": self.unit,
            "median": self.median,
            "min": min(self.values),
            "max": max(self.values),
            "n": len(self.values),
        }
        if self.goal is not None:
            record |= {"goal": str(self.goal), "met": self.is_met}
        if self.note:
            record["note"] = self.note
        if self.curve:
            record |= {"curve": self.curve, "x": self.x}
        return record


def figure(
    name: str, unit: str, values: Iterable[float], goal: Goal | None = None, note: str = ""
) -> Figure:
    """Return a figure of any iterable of values."""
    return Figure(name, unit, tuple(float(value) for value in values), goal, note)


def ratio(name: str, slow: Sequence[float], fast: Sequence[float], goal: Goal | None) -> Figure:
    """Return how many times longer ``slow`` takes than the median of ``fast``."""
    return figure(name, "x", [value / median(fast) for value in slow], goal)


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file atomically."""
    write_text(path, json.dumps(content, indent=1, ensure_ascii=False) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(path.name + ".part")
    beside.write_text(text, encoding="utf-8")
    os.replace(beside, path)  # noqa: PTH105 - atomic, and says so
