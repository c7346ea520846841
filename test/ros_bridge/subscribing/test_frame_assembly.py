"""Frames made of messages that come one by one."""

import itertools
import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import T_LINK_OPTICAL, pose_looking_down, pose_to_matrix
from oaisys_core.types import PinholeIntrinsics
from oaisys_ros_bridge.conversions import image_to_msg, intrinsics_to_msg, transform_to_msg
from oaisys_ros_bridge.motion import odometry_to_msg
from oaisys_ros_bridge.subscribing.frame_assembly import (
    COLOR_WAIT_S,
    MAX_WITHOUT_POSE,
    FrameAssembler,
)
from oaisys_ros_bridge.subscribing.synchronizer import PENDING

CAMERA = PinholeIntrinsics(8, 6, 10.0, 10.0, 3.5, 2.5)
RIG = pose_looking_down(1.0, 2.0, 9.0, yaw_rad=0.5)
STAMP_NS = 3_000_000_007


def header(frame_id: str, stamp_ns: int = STAMP_NS) -> Header:
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame_id)


def depth_msg(stamp_ns: int = STAMP_NS) -> Image:
    depth_m = np.arange(48, dtype=np.float32).reshape(6, 8)
    return image_to_msg(depth_m, "32FC1", header("camera_optical_frame", stamp_ns))


def color_msg() -> Image:
    rgb = np.arange(144, dtype=np.uint8).reshape(6, 8, 3)
    return image_to_msg(rgb, "rgb8", header("camera_optical_frame"))


def info_msg(stamp_ns: int = STAMP_NS) -> CameraInfo:
    return intrinsics_to_msg(CAMERA, header("camera_optical_frame", stamp_ns))


def tf_msg(stamp_ns: int = STAMP_NS) -> TFMessage:
    T_map_base = pose_to_matrix(RIG)
    return TFMessage(
        transforms=[transform_to_msg(T_map_base, header("map", stamp_ns), "base_link")]
    )


def static_msg() -> TFMessage:
    mount = transform_to_msg(np.eye(4), header("base_link"), "camera_link")
    optical = transform_to_msg(T_LINK_OPTICAL, header("camera_link"), "camera_optical_frame")
    return TFMessage(transforms=[mount, optical])


def assembler(*, use_color: bool = True) -> FrameAssembler:
    return FrameAssembler("map", use_color=use_color)


@pytest.mark.parametrize("order", itertools.permutations(range(5)))
def test_a_frame_is_complete_whatever_the_order_of_its_messages(order):
    made = assembler()
    steps = [
        lambda: made.add_static(static_msg()),
        lambda: made.add_transforms(tf_msg()),
        lambda: made.add_image("depth", depth_msg(), 0.0),
        lambda: made.add_image("info", info_msg(), 0.0),
        lambda: made.add_image("color", color_msg(), 0.0),
    ]
    for step in order[:-1]:
        steps[step]()
        assert made.pop() is None
    steps[order[-1]]()

    frame = made.pop()

    assert frame is not None
    assert made.pop() is None
    assert frame.stamp_ns == STAMP_NS
    assert frame.intrinsics == CAMERA
    assert frame.depth_m[5, 7] == 47
    assert frame.rgb is not None
    assert frame.rgb[5, 7, 2] == 143
    # Optical axes of a rig that looks down, turned by 0.5 rad: the image's top points along +x.
    np.testing.assert_allclose(frame.T_map_camera[:3, 3], (1, 2, 9), atol=1e-9)
    np.testing.assert_allclose(frame.T_map_camera[:3, 2], (0, 0, -1), atol=1e-9)
    up = (math.cos(0.5), math.sin(0.5), 0)
    np.testing.assert_allclose(-frame.T_map_camera[:3, 1], up, atol=1e-9)


def test_odometry_serves_as_well_as_tf():
    made = assembler(use_color=False)
    made.add_static(static_msg())
    made.add_odometry(odometry_to_msg(RIG, header("map"), "base_link"))
    made.add_image("depth", depth_msg(), 0.0)
    made.add_image("info", info_msg(), 0.0)

    frame = made.pop()

    assert frame is not None
    assert frame.rgb is None
    np.testing.assert_allclose(frame.T_map_camera[:3, 3], (1, 2, 9), atol=1e-9)


def test_a_transform_of_another_stamp_does_not_place_a_frame():
    made = assembler(use_color=False)
    made.add_static(static_msg())
    made.add_transforms(tf_msg(STAMP_NS + 1))
    made.add_image("depth", depth_msg(), 0.0)
    made.add_image("info", info_msg(), 0.0)

    assert made.pop() is None
    made.add_transforms(tf_msg())
    assert made.pop() is not None


def test_a_frame_whose_colour_never_comes_goes_on_grey():
    made = assembler()
    made.add_static(static_msg())
    made.add_transforms(tf_msg())
    made.add_image("depth", depth_msg(), 10.0)
    made.add_image("info", info_msg(), 10.0)

    made.give_up_color(10.0 + COLOR_WAIT_S)
    assert made.pop() is None
    made.give_up_color(10.1 + COLOR_WAIT_S)

    frame = made.pop()
    assert frame is not None
    assert frame.rgb is None


def begun_frame(stamp_ns: int = STAMP_NS) -> FrameAssembler:
    """A frame that has everything but its colour, at 10 s."""
    made = assembler()
    made.add_static(static_msg())
    made.add_transforms(tf_msg(stamp_ns))
    made.add_image("depth", depth_msg(stamp_ns), 10.0)
    made.add_image("info", info_msg(stamp_ns), 10.0)
    return made


def test_colour_may_take_as_long_as_it_likes_where_the_end_of_samples_is_told():
    made = begun_frame()
    made.give_up_color(1000.0, samples_are_announced=True)
    assert made.pop() is None
    made.add_image("color", color_msg(), 1001.0)
    frame = made.pop()
    assert frame is not None
    assert frame.rgb is not None


def test_a_frame_of_a_sample_without_colour_goes_on_at_its_end():
    made = begun_frame()
    made.end_sample(STAMP_NS, 11.0, kinds=())
    frame = made.pop()
    assert frame is not None
    assert frame.rgb is None


def test_colour_that_was_lost_on_the_way_is_waited_for_after_the_end():
    made = begun_frame()
    made.end_sample(STAMP_NS, 500.0, kinds=("color",))
    assert made.pop() is None
    made.give_up_color(500.1 + COLOR_WAIT_S, samples_are_announced=True)
    frame = made.pop()
    assert frame is not None
    assert frame.rgb is None


def test_a_frame_of_a_sample_that_failed_is_dropped():
    made = begun_frame()
    made.end_sample(STAMP_NS + 1, 20.0, kinds=("color",))
    made.give_up_color(20.1 + COLOR_WAIT_S, samples_are_announced=True)
    assert made.pop() is None
    made.add_image("color", color_msg(), 30.0)
    assert made.pop() is None


def test_frames_without_a_pose_are_bounded_and_the_oldest_is_given_up():
    made = assembler(use_color=False)
    made.add_static(static_msg())
    for stamp_ns in range(MAX_WITHOUT_POSE + 1):
        made.add_image("depth", depth_msg(stamp_ns), 0.0)
        made.add_image("info", info_msg(stamp_ns), 0.0)
    for stamp_ns in range(MAX_WITHOUT_POSE + 1):
        made.add_transforms(tf_msg(stamp_ns))

    stamps_ns = [frame.stamp_ns for frame in iter(made.pop, None)]

    assert stamps_ns == list(range(1, MAX_WITHOUT_POSE + 1))


def test_a_frame_with_a_camera_that_folds_its_image_is_refused_once():
    made = assembler(use_color=False)
    made.add_static(static_msg())
    made.add_transforms(tf_msg())
    info = info_msg()
    info.d = [-9.0, 0.0, 0.0, 0.0, 0.0]
    made.add_image("depth", depth_msg(), 0.0)
    made.add_image("info", info, 0.0)

    with pytest.raises(InvalidInputError, match=r"camera_info\.d"):
        made.pop()
    assert made.pop() is None


def semantic_frame(*kinds: str) -> FrameAssembler:
    made = FrameAssembler("map", use_color=True, use_semantics=True)
    made.add_static(static_msg())
    made.add_transforms(tf_msg())
    labels = np.arange(48, dtype=np.uint16).reshape(6, 8)
    messages = {
        "depth": depth_msg(),
        "info": info_msg(),
        "color": color_msg(),
        "semantic": image_to_msg(labels, "16UC1", header("camera_optical_frame")),
    }
    for kind in kinds:
        made.add_image(kind, messages[kind], 0.0)
    return made


def test_a_frame_waits_for_colour_and_labels():
    assert semantic_frame("depth", "info", "color").pop() is None
    frame = semantic_frame("semantic", "depth", "info", "color").pop()
    assert frame is not None
    assert frame.labels is not None
    np.testing.assert_array_equal(frame.labels, np.arange(48).reshape(6, 8))


@pytest.mark.parametrize("end_first", [True, False])
def test_what_a_sample_will_not_have_is_not_waited_for_but_the_rest_is(end_first: bool):
    made = semantic_frame("depth", "info")
    if end_first:
        made.end_sample(STAMP_NS, 1.0, kinds=("color",))
        assert made.pop() is None
    made.add_image("color", color_msg(), 1.0)
    if not end_first:
        assert made.pop() is None
        made.end_sample(STAMP_NS, 1.0, kinds=("color",))
    frame = made.pop()
    assert frame is not None
    assert frame.rgb is not None
    assert frame.labels is None


def test_depth_images_that_never_find_their_camera_are_counted():
    made = assembler(use_color=False)
    for stamp_ns in range(PENDING + 3):
        made.add_image("depth", depth_msg(stamp_ns), 0.0)
    assert made.dropouts == 3
    made.clear()
    assert made.dropouts == 0


def test_colours_of_another_camera_are_refused():
    made = begun_frame()
    other = PinholeIntrinsics(8, 6, 12.0, 12.0, 3.5, 2.5)
    made.add_color_info(intrinsics_to_msg(other, header("camera_optical_frame")))
    made.add_image("color", color_msg(), 0.0)
    with pytest.raises(InvalidInputError, match="color/camera_info"):
        made.pop()


def test_depth_in_millimetres_and_colours_in_any_order_are_understood():
    made = assembler()
    made.add_static(static_msg())
    made.add_transforms(tf_msg())
    millimetres = np.full((6, 8), 2500, np.uint16)
    millimetres[0, 0] = 0
    bgra = np.tile(np.array([3, 2, 1, 255], np.uint8), (6, 8, 1))
    optical = header("camera_optical_frame")
    made.add_image("depth", image_to_msg(millimetres, "16UC1", optical), 0.0)
    made.add_image("color", image_to_msg(bgra, "bgra8", optical), 0.0)
    made.add_image("info", info_msg(), 0.0)
    frame = made.pop()
    assert frame is not None
    assert math.isnan(frame.depth_m[0, 0])
    assert frame.depth_m[1, 1] == np.float32(2.5)
    assert frame.rgb is not None
    assert frame.rgb[2, 3].tolist() == [1, 2, 3]
