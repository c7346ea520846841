"""Images, cameras and poses that lie: refused with a sentence, and the mapper goes on."""

from __future__ import annotations

import array
import copy
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_core.types import PinholeIntrinsics
from oaisys_mapping.tsdf import TsdfConfig
from oaisys_ros_bridge.clouds import cloud_from_msg
from oaisys_ros_bridge.conversions import image_to_msg, intrinsics_to_msg
from oaisys_ros_bridge.mapper.fusion import Fusion
from oaisys_ros_bridge.subscribing.frame_assembly import FrameAssembler
from oaisys_ros_bridge.subscribing.transforms import MAX_FRAMES, FrameBuffer

FLOATS = (float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 1e19, 5e-324, 0.0, -1.0)
SIZES = (0, 1, 2**15, 2**31, 2**32 - 1)
ENCODINGS = ("", "32FC1", "16UC1", "8UC1", "rgb8", "64FC4", "32FC\x00", "bayer_rggb8", "x" * 10_000)
CAMERA = PinholeIntrinsics(16, 12, 14.0, 14.0, 7.5, 5.5)


def messages(stamp_ns: int) -> dict[str, Any]:
    """Return a frame's messages."""
    stamp = Time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    header = Header(stamp=stamp, frame_id="camera")
    transform = TransformStamped(
        header=Header(stamp=stamp, frame_id="map"), child_frame_id="camera"
    )
    transform.transform.rotation.w = 1.0
    return {
        "depth": image_to_msg(np.full((12, 16), 2.0, np.float32), "32FC1", header),
        "info": intrinsics_to_msg(CAMERA, header),
        "color": image_to_msg(np.zeros((12, 16, 3), np.uint8), "rgb8", header),
        "semantic": image_to_msg(np.ones((12, 16), np.uint16), "16UC1", header),
        "pose": TFMessage(transforms=[transform]),
    }


def lying_images(image: Image) -> Iterator[Image]:
    for field, values in (("width", SIZES), ("height", SIZES), ("step", SIZES)):
        for value in values:
            changed = copy.deepcopy(image)
            setattr(changed, field, value)
            yield changed
            changed = copy.deepcopy(changed)
            changed.data = array.array("B")
            yield changed
    for encoding in ENCODINGS:
        changed = copy.deepcopy(image)
        changed.encoding = encoding
        yield changed
    for number in FLOATS:
        changed = copy.deepcopy(image)
        with np.errstate(over="ignore"):
            changed.data = array.array("B", np.full((12, 16), number, np.float32).tobytes())
        yield changed
    changed = copy.deepcopy(image)
    changed.is_bigendian = 255
    yield changed


def lying_infos(info: CameraInfo) -> Iterator[CameraInfo]:
    for index, value in itertools.product(range(9), FLOATS):
        changed = copy.deepcopy(info)
        changed.k[index] = value
        yield changed
    for index, value in itertools.product(range(5), FLOATS):
        changed = copy.deepcopy(info)
        changed.d[index] = value
        yield changed
    for width, height in itertools.product(SIZES, SIZES):
        changed = copy.deepcopy(info)
        changed.width, changed.height = width, height
        yield changed
    for count in (1, 4, 8, 100_000):
        changed = copy.deepcopy(info)
        changed.d = [0.1] * count
        yield changed


def lying_poses(pose: TFMessage) -> Iterator[TFMessage]:
    for part, names in (("translation", "xyz"), ("rotation", "xyzw")):
        for name, value in itertools.product(names, FLOATS):
            changed = copy.deepcopy(pose)
            setattr(getattr(changed.transforms[0].transform, part), name, value)
            yield changed
    changed = copy.deepcopy(pose)
    changed.transforms[0].child_frame_id = "map"
    yield changed
    yield TFMessage()


LYING = {
    "depth": lying_images,
    "color": lying_images,
    "semantic": lying_images,
    "info": lying_infos,
    "pose": lying_poses,
}


@pytest.mark.parametrize("kind", LYING)
def test_no_message_ends_the_mapper(kind: str) -> None:
    assembler = FrameAssembler("map", use_color=True, use_semantics=True)
    faults: list[str] = []
    fusion = Fusion(
        TsdfConfig(voxel_size_m=0.2, max_range_m=10.0, semantic=True),
        on_change=lambda _: None,
        on_error=faults.append,
        on_done=lambda *_: None,
    )

    def take(whole: dict[str, Any]) -> None:
        for name, message in whole.items():
            try:
                if name == "pose":
                    assembler.add_transforms(message)
                else:
                    assembler.add_image(name, message, 0.0)
                while (frame := assembler.pop()) is not None:
                    fusion.add(frame)
            except OaisysError as error:
                faults.append(str(error))

    try:
        numbers = itertools.count(1)
        good = messages(next(numbers) * 10**6)
        for lie in LYING[kind](good[kind]):
            whole = messages(next(numbers) * 10**6)
            if kind == "pose":
                for transform in lie.transforms:
                    transform.header.stamp = whole["depth"].header.stamp
            else:
                lie.header = whole[kind].header
            take({**whole, kind: lie})
            fusion.surface(60.0)
        fused = fusion.state.integrated
        take(messages(next(numbers) * 10**6))
        mesh, _ = fusion.surface(60.0)
        assert fusion.state.integrated == fused + 1
        assert np.isfinite(mesh.vertices_m).all()
        assert faults
    finally:
        fusion.close()


def test_transforms_of_ever_new_frames_end_at_a_bound() -> None:
    """Each name was kept for good."""
    frames = FrameBuffer()
    for number in range(MAX_FRAMES):
        frames.set_at(1, "map", f"frame{number}", np.eye(4))
    for add in (frames.set_static, lambda *given: frames.set_at(2, *given)):
        with pytest.raises(InvalidInputError, match=f"at most {MAX_FRAMES} frames"):
            add("map", "another", np.eye(4))
    frames.set_at(2, "map", "frame0", np.eye(4))


def test_clouds_whose_fields_lie_are_refused() -> None:
    fields = [
        PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
        for i, name in enumerate(("x", "y", "z", "rgb"))
    ]
    good = PointCloud2(height=1, width=3, point_step=16, row_step=48, fields=fields)
    good.data = array.array("B", bytes(48))
    cloud_from_msg(good)
    for name, value in itertools.product(
        ("height", "width", "point_step", "row_step"), (0, 5, 2**31, 2**32 - 1)
    ):
        changed = copy.deepcopy(good)
        setattr(changed, name, value)
        with pytest.raises(InvalidInputError):
            cloud_from_msg(changed)
    for name, value in (("offset", 2**32 - 1), ("offset", 14), ("datatype", 200), ("count", 2**31)):
        changed = copy.deepcopy(good)
        setattr(changed.fields[2], name, value)
        with pytest.raises(InvalidInputError):
            cloud_from_msg(changed)
