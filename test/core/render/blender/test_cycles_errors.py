"""A render that Cycles logs an error about, or whose ground is black, has failed."""

from __future__ import annotations

import numpy as np
import pytest
from blender_process import in_new_blender

pytestmark = pytest.mark.blender


def test_what_cycles_logs_as_an_error_fails_the_render_each_time() -> None:
    errors, printed, (before, after) = in_new_blender("errors.overflowing")
    assert len(errors) == 3
    for error in errors:
        assert 'out of SVM stack space, shader "huge" too big' in error
    assert printed.count('out of SVM stack space, shader "huge" too big') >= 2
    assert np.array_equal(before, after)


@pytest.mark.long
def test_ground_that_is_black_without_an_error_fails_the_render() -> None:
    for kind, (before, failed, after) in in_new_blender("errors.black").items():
        assert "100% of the ground of the stage is black" in failed, kind
        assert (before, after) == ("", ""), kind


@pytest.mark.long
def test_a_texture_that_is_black_somewhere_is_rendered() -> None:
    assert in_new_blender("errors.black_texture") == ""
