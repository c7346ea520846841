"""Renders in Blender that are no longer wanted."""

from __future__ import annotations

import pytest
from blender_process import in_new_blender
from waiting import PATIENCE_S


@pytest.mark.blender
@pytest.mark.parametrize("lost", [0, 1])
def test_a_call_to_end_that_cycles_forgets_is_made_again(lost: int) -> None:
    told = in_new_blender("cancelling.calls_to_end", lost, PATIENCE_S / 4)

    assert told == [4711] * (lost + 1)
