"""A rig of cameras and a stereo pair over real nodes, read by what others read it with.

Clouds by their own description of their fields, as sensor_msgs_py reads them; depth by Open3D with
the published camera; points by OpenCV's `projectPoints`; transforms by SciPy.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import cv2
import numpy as np
import open3d as o3d
import pytest
from ros_peer import Stage, User
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from served_simulator import FLAT_WORLD
from tf2_msgs.msg import TFMessage

from oaisys_core.geometry import pose_looking_at
from oaisys_core.types import FloatArray, Pose
from oaisys_ros_bridge.qos import LATCHED_QOS, SENSOR_QOS, TF_QOS

pytestmark = pytest.mark.ros

SIZE = {"width_px": 160, "height_px": 120}
MODALITIES = ["rgb", "depth", "semantic_0", "semantic_1", "instance", "normal"]
BASELINE_M = 0.24


def quaternion(*angles_deg: float) -> list[float]:
    found: list[float] = Rotation.from_euler("xyz", angles_deg, degrees=True).as_quat().tolist()
    return found


FRONT = {
    **SIZE,
    "name": "front",
    "fx_px": 131.0,
    "fy_px": 139.5,
    "cx_px": 70.25,
    "cy_px": 65.5,
    "mount_position_m": [0.31, -0.17, 0.12],
    "mount_quat_xyzw": quaternion(8, 5, -12),
    "modalities": MODALITIES,
}
BENT = {
    **FRONT,
    "name": "bent",
    "distortion": {"k1": -0.18, "k2": 0.04, "p1": 1e-3, "p2": -2e-3, "k3": 0.01},
    "mount_position_m": [-0.2, 0.1, 0.4],
    "mount_quat_xyzw": quaternion(-15, 11, 7),
}
PAIR = {
    **FRONT,
    "name": "pair",
    "baseline_m": BASELINE_M,
    "mount_position_m": [0.05, 0.3, -0.1],
    "mount_quat_xyzw": quaternion(3, 20, 10),
}
NAMES = ("front", "bent", "pair_left", "pair_right")
WORLD: dict[str, Any] = {
    **FLAT_WORLD,
    "assets": {
        "rocks": [],
        "primitives": [{"shape": "sphere", "radius_m": 0.7, "position_m": [1.0, -0.5, 1.2]}],
    },
    "sensors": {"cameras": [FRONT, BENT], "stereo": [PAIR]},
}
TYPES = {
    PointField.INT8: "i1", PointField.UINT8: "u1", PointField.INT16: "i2", PointField.UINT16: "u2",
    PointField.INT32: "i4", PointField.UINT32: "u4", PointField.FLOAT32: "f4",
    PointField.FLOAT64: "f8",
}  # fmt: skip


def read_points(msg: PointCloud2) -> np.ndarray:
    """Return (H, W) records with a cloud's own fields."""
    order = ">" if msg.is_bigendian else "<"
    dtype = np.dtype(
        {
            "names": [field.name for field in msg.fields],
            "formats": [(order + TYPES[f.datatype], (f.count,)) for f in msg.fields],
            "offsets": [field.offset for field in msg.fields],
            "itemsize": msg.point_step,
        }
    )
    rows = np.frombuffer(bytes(msg.data), np.uint8).reshape(msg.height, msg.row_step)
    return rows[:, : msg.width * msg.point_step].copy().view(dtype)


def read_image(msg: Image, dtype: str, channels: int) -> np.ndarray:
    assert not msg.is_bigendian
    pixels = np.frombuffer(bytes(msg.data), dtype)
    return pixels.reshape(msg.height, msg.width, channels).squeeze()


def chained(user: User, stamp: Any, source: str) -> FloatArray:
    """Return the (4, 4) pose of a frame in ``map`` at a stamp."""
    static = [t for message in user.received["/tf_static"] for t in message.transforms]
    moving = [t for message in user.received["/tf"] for t in message.transforms]
    edges = {t.child_frame_id: t for t in static}
    edges |= {t.child_frame_id: t for t in moving if t.header.stamp == stamp}
    T, frame = np.eye(4), source
    while frame != "map":
        edge = edges[frame]
        t, q = edge.transform.translation, edge.transform.rotation
        T = matrix([t.x, t.y, t.z], [q.x, q.y, q.z, q.w]) @ T
        frame = edge.header.frame_id
    return T


def matrix(position_m: Any, quat_xyzw: Any) -> FloatArray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(quat_xyzw).as_matrix()
    T[:3, 3] = position_m
    return T


def mount(name: str) -> FloatArray:
    """Return the pose of a camera's link on the rig, as the configuration has it."""
    camera: dict[str, Any] = {"front": FRONT, "bent": BENT}.get(name, PAIR)
    aside = np.eye(4)
    if name == "pair_right":
        aside[1, 3] = -BASELINE_M
    return matrix(camera["mount_position_m"], camera["mount_quat_xyzw"]) @ aside


OPTICAL = matrix([0, 0, 0], [-0.5, 0.5, -0.5, 0.5])
"""Of z forward, x right, y down in x forward, y left, z up."""


def topics() -> dict[str, type[Any]]:
    found: dict[str, type[Any]] = {}
    for name in NAMES:
        for modality in ("color", "depth", "semantic_0", "semantic_1", "instance", "normal"):
            found[f"{name}/{modality}/image_raw"] = Image
            found[f"{name}/{modality}/camera_info"] = CameraInfo
        found[f"{name}/depth_registered/points"] = PointCloud2
    return found


def messages_of(user: User, stamp: Any) -> dict[str, Any]:
    def found() -> dict[str, Any] | None:
        of_stamp = {
            topic: message
            for topic in topics()
            for message in user.received[topic]
            if message.header.stamp == stamp
        }
        return of_stamp if len(of_stamp) == len(topics()) else None

    messages: dict[str, Any] = user.wait_until(found)
    return messages


@pytest.mark.long
def test_reference_consumers_see_what_we_publish(stage: Stage) -> None:
    user = stage.user
    server = stage.start_world(WORLD)
    for topic, kind in topics().items():
        user.listen(kind, topic, SENSOR_QOS)
    user.listen(TFMessage, "/tf", TF_QOS)
    user.listen(TFMessage, "/tf_static", LATCHED_QOS)
    stage.start_bridge(server.address)
    user.wait_until_ready()

    for eye_m in ((-4.0, 3.0, 4.0), (5.0, 2.0, 3.0), (2.0, -14.0, 9.0)):
        pose = pose_looking_at(eye_m, (1.0, -0.5, 1.2))
        answer = user.set_pose(pose)
        assert answer.success, answer.message
        sample = messages_of(user, answer.stamp)
        for name in NAMES:
            check_transforms(user, answer.stamp, name, pose)
            check_cameras(sample, name)
            check_cloud(sample, name)
            check_normals(sample, name)
            if name != "bent":  # P is of rectified images
                check_projection(user, answer.stamp, sample, name)
        check_pair(user, answer.stamp, sample)


@pytest.mark.long
def test_a_right_camera_can_have_its_own_frame(stage: Stage) -> None:
    """With `stereo.right_frame`: every image of both cameras, and disparities' consumers."""
    user = stage.user
    pair = {**PAIR, "modalities": ["rgb", "depth", "disparity"]}
    kinds = ("color", "depth", "disparity")
    server = stage.start_world({**WORLD, "sensors": {"stereo": [pair]}})
    heard = [f"{name}/{kind}" for name in ("pair_left", "pair_right") for kind in kinds]
    for each in heard:
        user.listen(CameraInfo, f"{each}/camera_info", SENSOR_QOS)
        user.listen(Image, f"{each}/image_raw", SENSOR_QOS)
    options = ("-p", f"address:={server.address}", "-p", "stereo.right_frame:=own")
    stage.start_node("bridge", "--ros-args", *options)
    user.wait_until_ready()
    assert user.set_pose(pose_looking_at((-4.0, 3.0, 4.0), (1.0, -0.5, 1.2))).success
    for each in heard:
        topics_of = (f"{each}/camera_info", f"{each}/image_raw")
        info, image = (user.wait_until(partial(user.received.get, t))[0] for t in topics_of)
        assert info.header == image.header
        assert info.header.frame_id == f"{each.partition('/')[0]}_optical_frame"
        assert info.p[3] == 0.0


def check_transforms(user: User, stamp: Any, name: str, pose: Pose) -> None:
    T_map_base = matrix(pose.position_m, pose.quat_xyzw)
    T_map_optical = T_map_base @ mount(name) @ OPTICAL
    user.wait_until(
        lambda: any(t.header.stamp == stamp for m in user.received["/tf"] for t in m.transforms)
    )

    np.testing.assert_allclose(chained(user, stamp, "base_link"), T_map_base, atol=1e-9)
    found = chained(user, stamp, f"{name}_optical_frame")
    np.testing.assert_allclose(found, T_map_optical, atol=1e-9)


def check_cameras(sample: dict[str, Any], name: str) -> None:
    infos = [m for t, m in sample.items() if t.startswith(f"{name}/") and "camera_info" in t]
    assert len(infos) == 6
    for info in infos:
        assert info.k.tolist() == infos[0].k.tolist()
    info = sample[f"{name}/color/camera_info"]
    assert (info.width, info.height, info.distortion_model) == (160, 120, "plumb_bob")
    assert list(info.k) == [131.0, 0, 70.25, 0, 139.5, 65.5, 0, 0, 1]
    bent = [-0.18, 0.04, 1e-3, -2e-3, 0.01]
    assert list(info.d) == (bent if name == "bent" else [0.0] * 5)
    assert list(info.r) == np.eye(3).ravel().tolist()
    to_left = -131.0 * BASELINE_M if name == "pair_right" else 0.0
    assert list(info.p) == [131.0, 0, 70.25, to_left, 0, 139.5, 65.5, 0, 0, 0, 1, 0]


def check_cloud(sample: dict[str, Any], name: str) -> None:
    msg, info = sample[f"{name}/depth_registered/points"], sample[f"{name}/depth/camera_info"]
    cloud = read_points(msg)
    assert cloud.shape == (120, 160)
    assert msg.header == info.header
    depth_m = read_image(sample[f"{name}/depth/image_raw"], "<f4", 1)
    xyz_m = np.stack([cloud[axis][..., 0] for axis in "xyz"], axis=-1)
    hit = np.isfinite(depth_m)
    assert hit.sum() > 1000
    assert np.isnan(xyz_m[~hit]).all()
    np.testing.assert_array_equal(xyz_m[hit][:, 2], depth_m[hit])
    packed = np.ascontiguousarray(cloud["rgb"][..., 0]).view("<u4")
    rgb = read_image(sample[f"{name}/color/image_raw"], "u1", 3).astype(np.uint32)
    np.testing.assert_array_equal(packed, rgb[..., 0] << 16 | rgb[..., 1] << 8 | rgb[..., 2])

    K, D = info.k.reshape(3, 3), np.array(info.d)
    zero = np.zeros(3)
    pixels = cv2.projectPoints(xyz_m[hit].astype(float), zero, zero, K, D)[0][:, 0]
    rows, columns = np.nonzero(hit)
    np.testing.assert_allclose(pixels, np.column_stack((columns, rows)), atol=1e-3)
    if name != "bent":  # Open3D knows no lenses
        check_open3d(info, depth_m, xyz_m[hit])


def check_open3d(info: CameraInfo, depth_m: np.ndarray, points_m: np.ndarray) -> None:
    camera = o3d.camera.PinholeCameraIntrinsic(
        info.width, info.height, info.k[0], info.k[4], info.k[2], info.k[5]
    )
    image = o3d.geometry.Image(np.where(np.isfinite(depth_m), depth_m, np.float32(0)))
    expected = o3d.geometry.PointCloud.create_from_depth_image(
        image, camera, depth_scale=1.0, depth_trunc=1e9
    )
    # float32 has no more digits for the ground near the horizon, kilometres away.
    digits = float(np.finfo(np.float32).eps)
    np.testing.assert_allclose(points_m, np.asarray(expected.points), atol=1e-5, rtol=digits)


def check_normals(sample: dict[str, Any], name: str) -> None:
    msg = sample[f"{name}/normal/image_raw"]
    assert msg.encoding == "32FC3"
    normals = read_image(msg, "<f4", 3)
    depth_m = read_image(sample[f"{name}/depth/image_raw"], "<f4", 1)
    lengths = np.linalg.norm(normals, axis=-1)
    np.testing.assert_allclose(lengths, np.isfinite(depth_m), atol=1e-5)


def check_projection(user: User, stamp: Any, sample: dict[str, Any], name: str) -> None:
    """P takes points of the frame that the camera_info names to the pixels of its image."""
    cloud_msg = sample[f"{name}/depth_registered/points"]
    cloud = read_points(cloud_msg)
    points_m = np.stack([cloud[axis][..., 0] for axis in "xyz"], axis=-1).astype(float)
    hit = np.isfinite(points_m[..., 2])
    rows, columns = np.nonzero(hit)
    T_map_cloud = chained(user, stamp, cloud_msg.header.frame_id)
    for modality in ("color", "depth", "semantic_0", "semantic_1", "instance", "normal"):
        info, image = (
            sample[f"{name}/{modality}/camera_info"],
            sample[f"{name}/{modality}/image_raw"],
        )
        assert info.header == image.header
        T = np.linalg.inv(chained(user, stamp, info.header.frame_id)) @ T_map_cloud
        x, y, z = T[:3, :3] @ points_m[hit].T + T[:3, 3:]
        # image_geometry's project3dToPixel:
        fx, cx, Tx, fy, cy, Ty = (info.p[i] for i in (0, 2, 3, 5, 6, 7))
        np.testing.assert_allclose((fx * x + Tx) / z + cx, columns, atol=1e-3)
        np.testing.assert_allclose((fy * y + Ty) / z + cy, rows, atol=1e-3)


def check_pair(user: User, stamp: Any, sample: dict[str, Any]) -> None:
    """The right camera's P takes points of the left one's frame to the right one's pixels."""
    color, depth = (sample[f"pair_right/{m}/camera_info"] for m in ("color", "depth"))
    assert color.header.frame_id == "pair_left_optical_frame"
    assert (depth.header.frame_id, depth.p[3]) == ("pair_right_optical_frame", 0.0)
    T_left_right = np.linalg.inv(chained(user, stamp, "pair_left_optical_frame")) @ chained(
        user, stamp, "pair_right_optical_frame"
    )
    np.testing.assert_allclose(T_left_right[:3, 3], [BASELINE_M, 0, 0], atol=1e-9)
    cloud = read_points(sample["pair_right/depth_registered/points"])
    points_m = np.stack([cloud[axis][..., 0] for axis in "xyz"], axis=-1).astype(float)
    hit = np.isfinite(points_m[..., 2])
    in_left = points_m[hit] @ T_left_right[:3, :3].T + T_left_right[:3, 3]
    P = np.array(sample["pair_right/color/camera_info"].p).reshape(3, 4)
    homogeneous = np.column_stack((in_left, np.ones(len(in_left)))) @ P.T
    rows, columns = np.nonzero(hit)
    expected = np.column_stack((columns, rows))
    np.testing.assert_allclose(homogeneous[:, :2] / homogeneous[:, 2:], expected, atol=1e-3)
