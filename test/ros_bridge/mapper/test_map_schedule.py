"""When maps of what is fused are due, and of which views, also around a reset."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import rclpy
from rclpy.node import Node
from waiting import wait_until

from oaisys_core.types import PinholeIntrinsics
from oaisys_mapping.tsdf import TsdfConfig
from oaisys_ros_bridge.mapper.fusion import DepthFrame, Fusion
from oaisys_ros_bridge.mapper.mapped_ground import MappedGround
from oaisys_ros_bridge.publishing.map_schedule import MapSchedule

pytestmark = pytest.mark.ros

CAMERA = PinholeIntrinsics(64, 48, 50.0, 50.0, 31.5, 23.5)


@pytest.fixture
def node() -> Iterator[Node]:
    context = rclpy.Context()
    rclpy.init(context=context)
    yield Node("maps", context=context)
    rclpy.shutdown(context=context)


@pytest.fixture
def fusion() -> Iterator[Fusion]:
    made = Fusion(TsdfConfig(voxel_size_m=0.2), on_change=lambda _: None, on_error=lambda _: None)
    yield made
    made.close()


def fuse(fusion: Fusion, x_m: float) -> None:
    """Fuse one more view of level ground, from 5 m above it."""
    T_map_camera = np.array([[0.0, -1, 0, x_m], [-1, 0, 0, 0], [0, 0, -1, 5], [0, 0, 0, 1]])
    count = fusion.state.integrated + 1
    assert fusion.add(
        DepthFrame(count, np.full((48, 64), 5.0, np.float32), None, CAMERA, T_map_camera)
    )
    wait_until(lambda: fusion.state.integrated == count)


def test_a_map_is_of_views_that_are_still_there(node: Node, fusion: Fusion) -> None:
    """An empty map with the stamp of the last view was published where a reset came between."""
    schedule = MapSchedule(node, "map", MappedGround(fusion).newest_view)
    assert schedule.take(0.0) is None
    fuse(fusion, 1.0)
    view = schedule.take(0.0)
    assert view is not None
    assert view.xy_m == (1.0, 0.0)
    assert schedule.still_has(view)
    fusion.reset()
    assert not schedule.still_has(view)
    assert schedule.take(0.0) is None
    fuse(fusion, 2.0)
    assert not schedule.still_has(view)


def test_the_first_view_after_a_reset_has_a_map_of_its_own(node: Node, fusion: Fusion) -> None:
    """It has the number of the first one before it, whose map was made."""
    schedule = MapSchedule(node, "map", MappedGround(fusion).newest_view)
    fuse(fusion, 1.0)
    assert schedule.take(0.0) is not None
    assert schedule.take(0.0) is None
    fusion.reset()
    fuse(fusion, 2.0)
    view = schedule.take(0.0)
    assert view is not None
    assert view.xy_m == (2.0, 0.0)
