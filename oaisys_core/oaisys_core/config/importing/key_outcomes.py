"""What can become of a key of an original configuration file.

Keys are dotted paths without the indices of lists; ``*`` stands for any key.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

OutcomeKind = Literal["mapped", "no effect", "no counterpart"]


@dataclass(frozen=True)
class KeyOutcome:
    """What becomes of a key.

    Attributes:
        kind: ``mapped`` to a key of ours, ``no effect`` in the original either, or ``no
            counterpart`` here.
        text: Where its value goes, or why it is left out.
    """

    kind: OutcomeKind
    text: str


KeyRule = tuple[tuple[str, ...], KeyOutcome]
"""Patterns of keys, and what becomes of the keys that match one."""


def mapped(text: str, *paths: str) -> KeyRule:
    """Return the rule for keys that ``text`` says where to find in our configuration."""
    return paths, KeyOutcome("mapped", text)


def no_effect(text: str, *paths: str) -> KeyRule:
    """Return the rule for keys that have no effect in the original either; ``text`` says why."""
    return paths, KeyOutcome("no effect", text)


def no_counterpart(text: str, *paths: str) -> KeyRule:
    """Return the rule for keys that are left out; ``text`` says why."""
    return paths, KeyOutcome("no counterpart", text)


def within(prefix: str, *names: str) -> tuple[str, ...]:
    """Return the dotted paths of keys below a prefix."""
    return tuple(f"{prefix}.{name}" for name in names)
