"""Numbers that are given by their digits."""

from __future__ import annotations

import pytest

from oaisys_core.files.numbers import LARGEST, whole_of


@pytest.mark.parametrize("number", [0, 7, 12, LARGEST])
def test_digits_are_their_number(number: int) -> None:
    assert whole_of(str(number)) == number


@pytest.mark.parametrize(
    "text", ["", "-1", "+1", " 1", "1_0", "1.0", "\u0661", "\u00b2", str(LARGEST + 1), "9" * 5000]
)
def test_other_texts_are_no_number(text: str) -> None:
    assert whole_of(text) is None
