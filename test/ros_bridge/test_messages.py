"""Messages against numpy, SciPy, OpenCV's camera model and Open3D's clouds."""

import struct
from dataclasses import replace
from typing import Any

import numpy as np
import open3d as o3d
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose as PoseMsg
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image, PointField
from std_msgs.msg import Header

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import PinholeIntrinsics, Pose
from oaisys_ros_bridge import clouds, conversions

HEADER = Header(stamp=Time(sec=7, nanosec=9), frame_id="somewhere")
CAMERA = PinholeIntrinsics(8, 6, 7.5, 7.25, 3.5, 2.25)


def random_pose(rng: np.random.Generator) -> Pose:
    x, y, z, w = Rotation.random(random_state=rng).as_quat()
    px, py, pz = rng.uniform(-50, 50, 3)
    return Pose((px, py, pz), (x, y, z, w))


@pytest.mark.parametrize("seed", range(5))
def test_a_pose_survives_the_way_there_and_back(seed: int) -> None:
    pose = random_pose(np.random.default_rng(seed))

    back = conversions.pose_from_msg(conversions.pose_to_msg(pose))
    odometry = conversions.odometry_to_msg(pose, HEADER, "base_link")

    assert back.position_m == pose.position_m
    assert back.quat_xyzw == pytest.approx(pose.quat_xyzw, abs=1e-15)
    assert conversions.odometry_from_msg(odometry).position_m == pose.position_m
    assert conversions.pose_to_stamped_msg(pose, HEADER).header == HEADER


def test_a_transform_takes_points_where_scipy_takes_them() -> None:
    pose = random_pose(np.random.default_rng(1))
    rotation = Rotation.from_quat(pose.quat_xyzw)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), pose.position_m
    point = np.array([1.0, -2.0, 3.0])

    msg = conversions.transform_to_msg(T, HEADER, "child")
    t, q = msg.transform.translation, msg.transform.rotation
    rotated = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply(point)
    moved = rotated + np.array([t.x, t.y, t.z])

    assert (msg.header.frame_id, msg.child_frame_id) == ("somewhere", "child")
    np.testing.assert_allclose(moved, rotation.apply(point) + pose.position_m, atol=1e-12)
    np.testing.assert_allclose(conversions.transform_from_msg(msg), T, atol=1e-12)


def test_camera_info_is_an_undistorted_pinhole_camera() -> None:
    msg = conversions.intrinsics_to_msg(CAMERA, HEADER)

    assert (msg.width, msg.height, msg.distortion_model) == (8, 6, "plumb_bob")
    assert list(msg.d) == [0.0] * 5
    assert list(msg.k) == [7.5, 0, 3.5, 0, 7.25, 2.25, 0, 0, 1]
    assert list(msg.r) == [1, 0, 0, 0, 1, 0, 0, 0, 1]
    assert list(msg.p) == [7.5, 0, 3.5, 0, 0, 7.25, 2.25, 0, 0, 0, 1, 0]
    assert conversions.intrinsics_from_msg(msg) == CAMERA


def test_camera_info_tells_the_distortion_of_a_lens() -> None:
    bent = replace(CAMERA, distortion=(-0.05, 0.01, 0.002, -0.001, 0.0003))

    msg = conversions.intrinsics_to_msg(bent, HEADER)

    assert (msg.distortion_model, list(msg.d)) == ("plumb_bob", list(bent.distortion))
    assert list(msg.p) == [7.5, 0, 3.5, 0, 0, 7.25, 2.25, 0, 0, 0, 1, 0]
    assert conversions.intrinsics_from_msg(msg) == bent


def test_the_right_camera_of_a_pair_says_how_far_away_it_is() -> None:
    msg = conversions.intrinsics_to_msg(CAMERA, HEADER, baseline_m=0.2)

    # A point at (x, y, z) in the left camera's frame is at column (fx x + cx z - fx b) / z.
    assert list(msg.p) == [7.5, 0, 3.5, -1.5, 0, 7.25, 2.25, 0, 0, 0, 1, 0]


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"d": [0.1] * 8, "distortion_model": "rational_polynomial"}, "camera_info.d"),
        ({"d": [-9.0, 0.0, 0.0, 0.0, 0.0]}, "camera_info.d"),
        ({"k": [7.5, 0.1, 3.5, 0.0, 7.25, 2.25, 0.0, 0.0, 1.0]}, "camera_info.k"),
        ({"k": [0.0] * 9}, "camera_info.k"),
    ],
)
def test_other_cameras_are_refused(change: dict[str, Any], field: str) -> None:
    msg = conversions.intrinsics_to_msg(CAMERA, HEADER)
    for name, value in change.items():
        setattr(msg, name, value)

    with pytest.raises(InvalidInputError) as caught:
        conversions.intrinsics_from_msg(msg)
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("encoding", "dtype", "shape", "pixel_bytes"),
    [
        ("rgb8", np.uint8, (6, 8, 3), 3),
        ("32FC1", np.float32, (6, 8), 4),
        ("32FC2", np.float32, (6, 8, 2), 8),
        ("32FC3", np.float32, (6, 8, 3), 12),
        ("16UC1", np.uint16, (6, 8), 2),
        ("32SC1", np.int32, (6, 8), 4),
    ],
)
def test_an_image_survives_the_way_there_and_back(
    encoding: str, dtype: type[np.generic], shape: tuple[int, ...], pixel_bytes: int
) -> None:
    data = np.random.default_rng(2).integers(0, 200, shape).astype(dtype)
    if encoding == "32FC1":
        data[0, 0] = np.inf

    msg = conversions.image_to_msg(data, encoding, HEADER)

    assert (msg.height, msg.width, msg.encoding) == (6, 8, encoding)
    assert msg.step == 8 * pixel_bytes
    assert bytes(msg.data) == data.tobytes()
    back = conversions.image_from_msg(msg)
    assert back.dtype == dtype
    np.testing.assert_array_equal(back, data)


def test_a_view_of_an_image_is_sent_as_it_looks() -> None:
    mirrored = np.arange(48, dtype=np.uint16).reshape(6, 8)[:, ::-1]

    msg = conversions.image_to_msg(mirrored, "16UC1", HEADER)

    np.testing.assert_array_equal(conversions.image_from_msg(msg), mirrored)


def test_padded_and_big_endian_images_are_understood() -> None:
    rows = [struct.pack(">3H", 1, 2, 300) + b"padding!" for _ in range(2)]
    msg = Image(height=2, width=3, encoding="16UC1", is_bigendian=1, step=14, data=b"".join(rows))

    np.testing.assert_array_equal(conversions.image_from_msg(msg), [[1, 2, 300]] * 2)


def test_instance_ids_must_fit_the_encoding() -> None:
    ids = np.array([[0, 2**31 - 1]], np.uint32)
    back = conversions.image_from_msg(conversions.image_to_msg(ids, "32SC1", HEADER))
    np.testing.assert_array_equal(back, ids)

    with pytest.raises(InvalidInputError, match="31 bits"):
        conversions.image_to_msg(ids + np.uint32(1), "32SC1", HEADER)


@pytest.mark.parametrize(
    ("data", "encoding", "field"),
    [
        (np.zeros((6, 8), np.float64), "32FC1", "image.data"),
        (np.zeros((6, 8), np.uint8), "rgb8", "image.data"),
        (np.zeros((6, 8, 3), np.uint16), "16UC1", "image.data"),
        (np.zeros((6, 8), np.uint8), "mono8", "image.encoding"),
    ],
)
def test_images_of_other_kinds_are_refused(data: NDArray[Any], encoding: str, field: str) -> None:
    with pytest.raises(InvalidInputError) as caught:
        conversions.image_to_msg(data, encoding, HEADER)
    assert caught.value.field == field


def test_an_image_cut_short_is_refused() -> None:
    msg = conversions.image_to_msg(np.zeros((6, 8), np.uint16), "16UC1", HEADER)
    msg.data = msg.data[:-1]

    with pytest.raises(InvalidInputError, match=r"image\.data"):
        conversions.image_from_msg(msg)


def test_a_cloud_is_what_open3d_makes_of_the_depth_image() -> None:
    rng = np.random.default_rng(3)
    depth_m = rng.uniform(0.5, 20.0, (6, 8)).astype(np.float32)
    depth_m[2, 3] = np.inf
    rgb = rng.integers(0, 256, (6, 8, 3)).astype(np.uint8)
    camera = o3d.camera.PinholeCameraIntrinsic(8, 6, 7.5, 7.25, 3.5, 2.25)
    hit = np.isfinite(depth_m)
    image = o3d.geometry.Image(np.where(hit, depth_m, np.float32(0)))
    expected = o3d.geometry.PointCloud.create_from_depth_image(
        image, camera, depth_scale=1.0, depth_trunc=100.0
    )

    msg = clouds.depth_to_cloud_msg(depth_m, rgb, CAMERA, HEADER)
    points_m, colors = clouds.cloud_from_msg(msg)

    assert (msg.height, msg.width, msg.point_step, msg.row_step) == (6, 8, 16, 128)
    assert not msg.is_dense
    assert [(f.name, f.offset, f.datatype) for f in msg.fields] == [
        (name, 4 * i, PointField.FLOAT32) for i, name in enumerate(("x", "y", "z", "rgb"))
    ]
    assert np.isnan(points_m[2, 3]).all()
    np.testing.assert_allclose(points_m[hit], np.asarray(expected.points), rtol=1e-6)
    np.testing.assert_array_equal(colors, rgb)
    # PCL reads the colour's bytes as blue, green, red.
    assert bytes(msg.data[12:15]) == bytes(rgb[0, 0, ::-1])


def test_a_mesh_survives_the_way_there_and_back() -> None:
    vertices_m = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.5]], float)
    triangles = np.array([[0, 1, 2], [0, 3, 1]], np.int32)
    rgb = np.array([[0, 0, 0], [255, 1, 2], [3, 128, 4], [7, 8, 250]], np.uint8)

    marker = clouds.mesh_to_marker(vertices_m, triangles, rgb, HEADER)
    corners_m, colors = clouds.mesh_from_marker(marker)

    assert marker.pose.orientation.w == 1.0
    assert (marker.scale.x, marker.scale.y, marker.scale.z) == (1.0, 1.0, 1.0)
    np.testing.assert_array_equal(corners_m, vertices_m[triangles])
    np.testing.assert_array_equal(colors, rgb[triangles])


@pytest.mark.parametrize(
    ("convert", "wrong", "name"),
    [
        (conversions.pose_from_msg, Image(), "pose"),
        (conversions.image_from_msg, PoseMsg(), "image"),
        (conversions.intrinsics_from_msg, PoseMsg(), "camera_info"),
        (conversions.transform_from_msg, PoseMsg(), "transform"),
        (clouds.cloud_from_msg, CameraInfo(), "cloud"),
        (clouds.mesh_from_marker, CameraInfo(), "marker"),
    ],
)
def test_a_message_of_another_type_is_named(convert: Any, wrong: object, name: str) -> None:
    with pytest.raises(TypeError, match=f"{name}: received {type(wrong).__name__}"):
        convert(wrong)
