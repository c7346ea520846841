"""Geometry computed beside colour: when it is ready, where its errors come, what it costs."""

from __future__ import annotations

import threading
import time
from contextvars import ContextVar

import numpy as np
import pytest

from oaisys_core.errors import CancelledError, RenderError
from oaisys_core.render.base import FrameGroup
from oaisys_core.render.geometry_pass import CORES, BackgroundGeometry
from oaisys_core.types import Frame, PinholeIntrinsics

PATIENCE_S = 30.0
INTRINSICS = PinholeIntrinsics(width_px=2, height_px=2, fx_px=2.0, fy_px=2.0, cx_px=0.5, cy_px=0.5)
FRAMES = (Frame("camera", "depth", np.zeros((2, 2), np.float32), INTRINSICS, np.eye(4)),)


def test_frames_are_computed_while_the_block_is_at_work() -> None:
    computed = threading.Event()
    threads = []

    def compute() -> tuple[Frame, ...]:
        threads.append(threading.current_thread())
        computed.set()
        return FRAMES

    with BackgroundGeometry(compute) as geometry:
        assert computed.wait(PATIENCE_S)
        assert geometry.group.result() is FRAMES
        assert geometry.group.is_done()
    assert threads != [threading.current_thread()]
    assert not threads[0].is_alive()


def test_a_group_is_not_done_while_it_is_computed() -> None:
    go_on = threading.Event()

    def compute() -> tuple[Frame, ...]:
        assert go_on.wait(PATIENCE_S)
        return FRAMES

    with BackgroundGeometry(compute) as geometry:
        changed = geometry.group.map_frames(lambda frames: frames[:0])
        assert not geometry.group.is_done()
        assert not changed.is_done()
        go_on.set()
        assert changed.result() == ()
        assert geometry.group.result() is FRAMES


def test_a_changed_group_is_changed_once() -> None:
    changes: list[tuple[Frame, ...]] = []

    def change(frames: tuple[Frame, ...]) -> tuple[Frame, ...]:
        changes.append(frames)
        return frames[:]

    group = FrameGroup.of(FRAMES).map_frames(change)
    assert changes == []
    askers = [threading.Thread(target=group.result) for _ in range(4)]
    for asker in askers:
        asker.start()
    for asker in askers:
        asker.join(PATIENCE_S)
    assert changes == [FRAMES]


@pytest.mark.parametrize("error", [CancelledError("enough"), RenderError("no rays")])
def test_errors_come_where_the_frames_are_asked_for(error: Exception) -> None:
    def fail() -> tuple[Frame, ...]:
        raise error

    with (
        pytest.raises(type(error), match=str(error)),
        BackgroundGeometry(fail) as geometry,
    ):
        geometry.group.result()


def test_a_block_that_fails_waits_for_its_thread() -> None:
    go_on = threading.Event()
    computed: list[tuple[Frame, ...]] = []

    def compute() -> tuple[Frame, ...]:
        assert go_on.wait(PATIENCE_S)
        computed.append(FRAMES)
        return FRAMES

    def fail() -> None:
        with BackgroundGeometry(compute):
            threading.Timer(0.05, go_on.set).start()
            raise RenderError("no colour")

    with pytest.raises(RenderError, match="no colour"):
        fail()
    assert computed == [FRAMES]


def test_it_costs_other_work_at_most_its_own_share_of_the_cores() -> None:
    go_on = threading.Event()

    def compute() -> tuple[Frame, ...]:
        assert go_on.wait(PATIENCE_S)
        until_s = time.thread_time() + 0.1
        while time.thread_time() < until_s:
            pass
        return FRAMES

    with BackgroundGeometry(compute) as geometry:
        assert geometry.cost_s(0.0) == 0
        assert geometry.cost_s(0.003) == pytest.approx(0.003 / (CORES + 1))
        go_on.set()
        geometry.group.result()
        assert 0.1 / CORES <= geometry.cost_s(1000.0) < 1000 / (CORES + 1)


def test_the_callers_context_holds() -> None:
    root = ContextVar("root", default="nowhere")
    seen = []

    def compute() -> tuple[Frame, ...]:
        seen.append(root.get())
        return FRAMES

    root.set("assets")
    with BackgroundGeometry(compute):
        pass
    assert seen == ["assets"]
