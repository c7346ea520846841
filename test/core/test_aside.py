"""Frames that are computed aside: who hands them on, when, and what errors do."""

from __future__ import annotations

import threading
import time
from contextvars import ContextVar
from typing import Any

import numpy as np
import pytest

from oaisys_core.backend.blender.background_geometry import CORES, computed_aside
from oaisys_core.errors import CancelledError, RenderError
from oaisys_core.types import Frame, PinholeIntrinsics, Progress

PATIENCE_S = 30.0
INTRINSICS = PinholeIntrinsics(width_px=2, height_px=2, fx_px=2.0, fy_px=2.0, cx_px=0.5, cy_px=0.5)
FRAMES = (Frame("camera", "depth", np.zeros((2, 2), np.float32), INTRINSICS, np.eye(4)),)


def test_frames_are_handed_on_while_the_block_is_at_work() -> None:
    handed = threading.Event()
    threads = []

    def hand_on(frames: tuple[Frame, ...]) -> None:
        assert frames is FRAMES
        threads.append(threading.current_thread())
        handed.set()

    with computed_aside(lambda: FRAMES, hand_on) as aside:
        assert handed.wait(PATIENCE_S)
        assert aside.frames() is FRAMES
    assert threads != [threading.current_thread()]
    assert not threads[0].is_alive()


def test_nothing_is_handed_on_where_there_is_nothing() -> None:
    told: list[tuple[Frame, ...]] = []
    with computed_aside(lambda: (), told.append) as aside:
        assert aside.frames() == ()
    assert told == []


def test_callbacks_are_never_called_at_once() -> None:
    begun, go_on = threading.Event(), threading.Event()
    order = []

    def hand_on(frames: tuple[Frame, ...]) -> None:
        begun.set()
        assert go_on.wait(PATIENCE_S)
        order.append("frames")

    with computed_aside(lambda: FRAMES, hand_on) as aside:
        assert begun.wait(PATIENCE_S)
        telling = threading.Thread(
            target=aside.tell, args=(lambda _: order.append("progress"), Progress("color", 0.0))
        )
        telling.start()
        telling.join(0.05)
        assert order == []
        go_on.set()
        telling.join(PATIENCE_S)
    assert order == ["frames", "progress"]


@pytest.mark.parametrize("error", [CancelledError("enough"), RenderError("no rays")])
def test_errors_come_where_the_frames_are_asked_for(error: Exception) -> None:
    def fail(*_: object) -> Any:
        raise error

    for compute, hand_on in ((fail, print), (lambda: FRAMES, fail)):
        with (
            pytest.raises(type(error), match=str(error)),
            computed_aside(compute, hand_on) as aside,
        ):
            aside.frames()


def test_a_block_that_fails_waits_for_its_thread() -> None:
    go_on = threading.Event()
    told: list[tuple[Frame, ...]] = []

    def compute() -> tuple[Frame, ...]:
        assert go_on.wait(PATIENCE_S)
        return FRAMES

    def fail() -> None:
        with computed_aside(compute, told.append):
            threading.Timer(0.05, go_on.set).start()
            raise RenderError("no colour")

    with pytest.raises(RenderError, match="no colour"):
        fail()
    assert told == [FRAMES]


def test_it_costs_other_work_at_most_its_own_share_of_the_cores() -> None:
    finished = threading.Event()

    def compute() -> tuple[Frame, ...]:
        until_s = time.thread_time() + 0.1
        while time.thread_time() < until_s:
            pass
        return FRAMES

    with computed_aside(compute, lambda _: finished.set()) as aside:
        assert aside.cost_s(0.0) == 0
        assert finished.wait(PATIENCE_S)
        assert aside.cost_s(0.003) == pytest.approx(0.003 / (CORES + 1))
        assert 0.1 / CORES <= aside.cost_s(1000.0) < 1000 / (CORES + 1)


def test_the_callers_context_holds() -> None:
    root = ContextVar("root", default="nowhere")
    seen = []

    def compute() -> tuple[Frame, ...]:
        seen.append(root.get())
        return FRAMES

    root.set("assets")
    with computed_aside(compute, lambda _: None):
        pass
    assert seen == ["assets"]
