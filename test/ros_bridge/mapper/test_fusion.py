"""The thread that fuses frames into a volume."""

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from oaisys_core.errors import DeadlineExceededError, OaisysError
from oaisys_core.types import PinholeIntrinsics
from oaisys_mapping import tsdf
from oaisys_mapping.tsdf import TsdfConfig
from oaisys_ros_bridge.mapper.fusion import QUEUE_FRAMES, DepthFrame, Fusion

CAMERA = PinholeIntrinsics(64, 48, 50.0, 50.0, 31.5, 23.5)
LOOKING_DOWN = np.array([[0.0, -1, 0, 0], [-1, 0, 0, 0], [0, 0, -1, 5], [0, 0, 0, 1]])
"""Optical frame 5 m above the ground: z down, x towards -y, y towards -x."""


def ground_frame(stamp_ns: int, height_m: float = 0.0) -> DepthFrame:
    """Return what the camera sees of level ground at ``height_m``."""
    depth_m = np.full((48, 64), 5.0 - height_m, np.float32)
    return DepthFrame(stamp_ns, depth_m, None, CAMERA, LOOKING_DOWN)


class Watched:
    """A fusion, what it told, and a gate that its thread passes after every frame."""

    def __init__(self) -> None:
        self.errors: list[str] = []
        self.gate = threading.Event()
        self.gate.set()
        self.passed = threading.Semaphore(0)
        self.fusion = Fusion(
            TsdfConfig(voxel_size_m=0.1), on_change=self._on_change, on_error=self.errors.append
        )

    def _on_change(self, _: object) -> None:
        self.passed.release()
        assert self.gate.wait(30)

    def close(self) -> None:
        self.gate.set()
        self.fusion.close()


@pytest.fixture
def watched() -> Iterator[Watched]:
    made = Watched()
    yield made
    made.close()


def test_the_surface_holds_all_frames_received_before_it_was_asked_for(watched):
    for stamp_ns in (1, 2, 3):
        assert watched.fusion.add(ground_frame(stamp_ns))

    mesh, views = watched.fusion.surface(30.0)

    assert len(views) == 3
    assert watched.fusion.state.integrated == 3
    assert watched.fusion.state.stamp_ns == 3
    assert np.abs(mesh.vertices_m[:, 2]).max() < 1e-3
    # The image covers 64 / 50 * 5 m = 6.4 m across and 4.8 m along.
    np.testing.assert_allclose(np.ptp(mesh.vertices_m[:, :2], axis=0), (4.8, 6.4), atol=0.25)


def test_a_frame_that_cannot_be_used_is_counted_and_told_and_the_next_is_fused(watched):
    bad = DepthFrame(1, np.ones((2, 2), np.float32), None, CAMERA, LOOKING_DOWN)

    watched.fusion.add(bad)
    watched.fusion.add(ground_frame(2))
    _, views = watched.fusion.surface(30.0)

    assert len(views) == 1
    assert watched.fusion.state.dropped == 1
    assert len(watched.errors) == 1
    assert "depth_m" in watched.errors[0]


def test_a_full_queue_drops_the_newest_frame_and_counts_it(watched):
    watched.gate.clear()
    watched.fusion.add(ground_frame(0))
    assert watched.passed.acquire(timeout=30)

    added = [watched.fusion.add(ground_frame(1 + i)) for i in range(QUEUE_FRAMES + 1)]

    assert added == [True] * QUEUE_FRAMES + [False]
    assert watched.fusion.state.dropped == 1
    with pytest.raises(DeadlineExceededError, match="not integrated within"):
        watched.fusion.surface(0.05)
    watched.gate.set()
    watched.fusion.surface(30.0)
    assert watched.fusion.state.integrated == QUEUE_FRAMES + 1


def test_a_reset_forgets_the_map_and_the_frames_that_wait(watched):
    watched.gate.clear()
    watched.fusion.add(ground_frame(1))
    assert watched.passed.acquire(timeout=30)
    watched.fusion.add(ground_frame(2))
    watched.gate.set()

    watched.fusion.reset()
    watched.fusion.add(ground_frame(3, height_m=1.0))
    mesh, views = watched.fusion.surface(30.0)

    assert len(views) == 1
    assert watched.fusion.state.integrated == 1
    np.testing.assert_allclose(mesh.vertices_m[:, 2], 1.0, atol=1e-3)


def test_frames_wait_until_the_volume_is_made(monkeypatch):
    may_be_made, make = threading.Event(), tsdf.TsdfVolume

    def slow(config: TsdfConfig) -> tsdf.TsdfVolume:
        assert may_be_made.wait(30)
        return make(config)

    monkeypatch.setattr(tsdf, "TsdfVolume", slow)
    waiting = Watched()
    try:
        assert all(waiting.fusion.add(ground_frame(stamp_ns)) for stamp_ns in (1, 2, 3))
        assert waiting.fusion.state.integrated == 0
        may_be_made.set()
        _, views = waiting.fusion.surface(30.0)
    finally:
        may_be_made.set()
        waiting.close()
    assert len(views) == 3


def test_a_volume_that_cannot_be_made_costs_every_frame_and_is_told(monkeypatch):
    def broken(_: TsdfConfig) -> tsdf.TsdfVolume:
        raise ImportError("no libtbb.so.12")

    monkeypatch.setattr(tsdf, "TsdfVolume", broken)
    failing = Watched()
    try:
        for stamp_ns in (1, 2):
            failing.fusion.add(ground_frame(stamp_ns))
        for _ in range(2):
            assert failing.passed.acquire(timeout=30)
        with pytest.raises(OaisysError, match=r"cannot be made.*libtbb"):
            failing.fusion.surface(30.0)
    finally:
        failing.close()
    assert failing.fusion.state.dropped == 2
    assert len(failing.errors) == 2
