"""Transforms at exact stamps."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import transform
from oaisys_ros_bridge.subscribing.transforms import HISTORY, MAX_STAMPS, FrameBuffer


def test_a_chain_of_moving_and_fixed_frames_multiplies_from_the_root():
    T_map_base = transform(Rotation.from_euler("z", 90, degrees=True).as_matrix(), (10, 0, 5))
    T_base_camera = transform(np.eye(3), (1, 0, 0))
    buffer = FrameBuffer()
    buffer.set_static("base_link", "camera", T_base_camera)
    buffer.set_at(7, "map", "base_link", T_map_base)

    T_map_camera = buffer.lookup("map", "camera", 7)

    assert T_map_camera is not None
    # The camera sits 1 m ahead of a body that was turned to face +y.
    np.testing.assert_allclose(T_map_camera[:3, 3], (10, 1, 5), atol=1e-12)
    np.testing.assert_allclose(T_map_camera[:3, 0], (0, 1, 0), atol=1e-12)


def test_there_is_no_pose_between_stamps():
    buffer = FrameBuffer()
    buffer.set_at(10, "map", "base_link", np.eye(4))
    buffer.set_at(20, "map", "base_link", np.eye(4))

    assert buffer.lookup("map", "base_link", 15) is None
    assert buffer.lookup("map", "unknown", 10) is None
    assert buffer.lookup("map", "base_link", 20) is not None


def test_the_history_is_bounded_and_loses_the_oldest():
    buffer = FrameBuffer()
    for stamp_ns in range(HISTORY + 1):
        moved = transform(np.eye(3), (float(stamp_ns), 0, 0))
        buffer.set_at(stamp_ns, "map", "base_link", moved)

    assert buffer.lookup("map", "base_link", 0) is None
    assert buffer.lookup("map", "base_link", 1) is not None
    assert buffer.lookup("map", "base_link", HISTORY) is not None


def test_a_pose_that_is_repeated_pushes_out_no_other():
    """An image may come minutes after its pose, which is repeated all the while."""
    buffer = FrameBuffer()
    moved = transform(np.eye(3), (1, 0, 0))
    buffer.set_at(1, "map", "base_link", np.eye(4))
    buffer.set_at(2, "map", "base_link", moved)
    for stamp_ns in range(3, 10 * HISTORY):
        buffer.set_at(stamp_ns, "map", "base_link", moved)

    assert buffer.lookup("map", "base_link", 1) is not None
    found = buffer.lookup("map", "base_link", 2)
    assert found is not None
    np.testing.assert_array_equal(found, moved)

    for stamp_ns in range(10 * HISTORY, MAX_STAMPS + 3):
        buffer.set_at(stamp_ns, "map", "base_link", moved)
    assert buffer.lookup("map", "base_link", 2) is None


def test_stamps_that_come_again_and_again_are_kept():
    buffer = FrameBuffer()
    for _ in range(3 * HISTORY):
        for stamp_ns in (1, 2):
            moved = transform(np.eye(3), (float(stamp_ns), 0, 0))
            buffer.set_at(stamp_ns, "map", "base_link", moved)

    assert buffer.lookup("map", "base_link", 1) is not None
    assert buffer.lookup("map", "base_link", 2) is not None


def test_a_frame_can_change_its_parent():
    """As base_link does where odometry begins to drift."""
    buffer = FrameBuffer()
    buffer.set_at(1, "map", "base_link", transform(np.eye(3), (1, 0, 0)))
    buffer.set_at(2, "map", "odom", transform(np.eye(3), (0, 5, 0)))
    buffer.set_at(2, "odom", "base_link", transform(np.eye(3), (2, 0, 0)))

    for stamp_ns, position_m in ((1, (1, 0, 0)), (2, (2, 5, 0))):
        T_map_base = buffer.lookup("map", "base_link", stamp_ns)
        assert T_map_base is not None
        np.testing.assert_array_equal(T_map_base[:3, 3], position_m)


def test_frames_in_a_circle_are_refused():
    buffer = FrameBuffer()
    buffer.set_static("a", "b", np.eye(4))
    buffer.set_static("b", "a", np.eye(4))

    with pytest.raises(InvalidInputError, match="leads to 'map'"):
        buffer.lookup("map", "a", 0)


def test_names_of_frames_are_bounded() -> None:
    buffer = FrameBuffer()
    for parent, child in (("map", "x" * 256), ("x" * 256, "camera")):
        with pytest.raises(InvalidInputError, match="at most 255 characters"):
            buffer.set_static(parent, child, np.eye(4))
        with pytest.raises(InvalidInputError, match="at most 255 characters"):
            buffer.set_at(1, parent, child, np.eye(4))
    buffer.set_at(1, "map", "x" * 255, np.eye(4))
    assert buffer.lookup("map", "x" * 255, 1) is not None
