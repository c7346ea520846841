"""What becomes of each key of an original configuration file; the table is in ``keys.yaml``."""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Literal

import yaml

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


def outcome_of(path: str) -> KeyOutcome | None:
    """Return what becomes of a key, given by its dotted path; None if the key is unknown."""
    for pattern, outcome in _rules():
        if fnmatchcase(path, pattern):
            return outcome
    return None


@cache
def _rules() -> tuple[tuple[str, KeyOutcome], ...]:
    table = yaml.safe_load(Path(__file__).with_name("keys.yaml").read_text(encoding="utf-8"))
    return tuple(
        (f"{section}.{name}", KeyOutcome(kind, text))
        for section, kinds in table.items()
        for kind, texts in kinds.items()
        for text, names in texts.items()
        for name in names
    )
