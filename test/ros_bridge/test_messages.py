"""Messages against numpy, SciPy, OpenCV's camera model and Open3D's clouds."""

import struct
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import open3d as o3d
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose as PoseMsg
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image, PointField
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import depth_to_points, pose_to_matrix
from oaisys_core.types import Frame, PinholeIntrinsics, Pose
from oaisys_ros_bridge import clouds, conversions
from oaisys_ros_bridge.publishing import trajectory_topics
from oaisys_ros_bridge.topic_names import encoding_of

HEADER = Header(stamp=Time(sec=7, nanosec=9), frame_id="somewhere")
CAMERA = PinholeIntrinsics(8, 6, 7.5, 7.25, 3.5, 2.25)


def random_pose(rng: np.random.Generator) -> Pose:
    x, y, z, w = Rotation.random(random_state=rng).as_quat()
    px, py, pz = rng.uniform(-50, 50, 3)
    return Pose((px, py, pz), (x, y, z, w))


def test_a_stamp_survives_the_way_there_and_back() -> None:
    stamp = conversions.stamp_from_nanoseconds(7_000_000_009)

    assert stamp == HEADER.stamp
    assert conversions.nanoseconds(stamp) == 7_000_000_009


@pytest.mark.parametrize("seed", range(5))
def test_a_pose_survives_the_way_there_and_back(seed: int) -> None:
    pose = random_pose(np.random.default_rng(seed))

    back = conversions.pose_from_msg(conversions.pose_to_msg(pose))

    assert back.position_m == pose.position_m
    assert back.quat_xyzw == pytest.approx(pose.quat_xyzw, abs=1e-15)
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


def test_camera_info_of_a_fisheye_is_equidistant() -> None:
    fisheye = replace(CAMERA, distortion=(0.05, -0.02, 0.004, 0.0), distortion_model="equidistant")

    msg = conversions.intrinsics_to_msg(fisheye, HEADER)
    plain = conversions.intrinsics_to_msg(replace(fisheye, distortion=()), HEADER)

    assert (msg.distortion_model, list(msg.d)) == ("equidistant", list(fisheye.distortion))
    assert list(msg.p) == [7.5, 0, 3.5, 0, 0, 7.25, 2.25, 0, 0, 0, 1, 0]
    assert conversions.intrinsics_from_msg(msg) == fisheye
    assert (plain.distortion_model, list(plain.d)) == ("equidistant", [0.0] * 4)
    assert conversions.intrinsics_from_msg(plain).is_fisheye


def test_the_right_camera_of_a_pair_says_how_far_away_it_is() -> None:
    msg = conversions.intrinsics_to_msg(CAMERA, HEADER, baseline_m=0.2)

    # A point at (x, y, z) in the left camera's frame is at column (fx x + cx z - fx b) / z.
    assert list(msg.p) == [7.5, 0, 3.5, -1.5, 0, 7.25, 2.25, 0, 0, 0, 1, 0]


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"d": [0.1] * 8, "distortion_model": "rational_polynomial"}, "camera_info.d"),
        ({"d": [-9.0, 0.0, 0.0, 0.0, 0.0]}, "camera_info.d"),
        ({"d": [0.1] * 5, "distortion_model": "equidistant"}, "camera_info.d"),
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


@pytest.mark.parametrize(
    ("modality", "pixel_bytes"),
    [
        ("mono16", 2),
        ("rgb16", 6),
        *((f"bayer_{mosaic}16", 2) for mosaic in ("rggb", "bggr", "gbrg", "grbg")),
    ],
)
def test_digital_numbers_have_the_encoding_of_their_name(modality: str, pixel_bytes: int) -> None:
    """Bytes of a pixel as in ``sensor_msgs/image_encodings.hpp``; each was refused."""
    shape = (6, 8, 3) if modality == "rgb16" else (6, 8)
    data = np.random.default_rng(3).integers(0, 65536, shape).astype(np.uint16)
    frame = Frame("camera", modality, data, CAMERA, np.eye(4))

    msg = conversions.image_to_msg(data, encoding_of(frame), HEADER)

    assert (msg.encoding, msg.step) == (modality, 8 * pixel_bytes)
    np.testing.assert_array_equal(conversions.image_from_msg(msg), data)


def test_a_view_of_an_image_is_sent_as_it_looks() -> None:
    mirrored = np.arange(48, dtype=np.uint16).reshape(6, 8)[:, ::-1]

    msg = conversions.image_to_msg(mirrored, "16UC1", HEADER)

    np.testing.assert_array_equal(conversions.image_from_msg(msg), mirrored)


def test_padded_and_big_endian_images_are_understood() -> None:
    rows = [struct.pack(">3H", 1, 2, 300) + b"padding!" for _ in range(2)]
    msg = Image(height=2, width=3, encoding="16UC1", is_bigendian=1, step=14, data=b"".join(rows))

    found = conversions.image_from_msg(msg)
    np.testing.assert_array_equal(found, [[1, 2, 300]] * 2)
    assert found.dtype.isnative, "views of it by another type would have its bytes swapped"


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
        (np.zeros((6, 8), np.uint8), "yuv422", "image.encoding"),
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


def open3d_points(depth_m: NDArray[Any], camera: PinholeIntrinsics) -> NDArray[Any]:
    """Return the points that Open3D makes of a depth image, row by row, without invalid ones."""
    pinhole = o3d.camera.PinholeCameraIntrinsic(
        camera.width_px, camera.height_px, camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
    )
    image = o3d.geometry.Image(np.where(np.isfinite(depth_m), depth_m, np.float32(0)))
    cloud = o3d.geometry.PointCloud.create_from_depth_image(
        image, pinhole, depth_scale=1.0, depth_trunc=1e9
    )
    return np.asarray(cloud.points)


WIDE = PinholeIntrinsics(64, 48, 54.1, 53.7, 30.25, 25.5)


def test_a_cloud_from_high_above_is_as_exact_as_float32_can_be() -> None:
    depth_m = np.random.default_rng(5).uniform(100, 200, (48, 64)).astype(np.float32)

    points_m, _ = clouds.cloud_from_msg(clouds.depth_to_cloud_msg(depth_m, None, WIDE, HEADER))

    expected_m = open3d_points(depth_m, WIDE)
    np.testing.assert_allclose(points_m.reshape(-1, 3), expected_m, atol=1e-5, rtol=0)


def test_a_cloud_without_sky_is_one_row_of_points_with_their_colors() -> None:
    rng = np.random.default_rng(6)
    depth_m = rng.uniform(1, 9, (48, 64)).astype(np.float32)
    depth_m[rng.random(depth_m.shape) < 0.3] = np.inf
    depth_m[0, 0], depth_m[0, 1] = np.nan, -np.inf
    rgb = rng.integers(0, 256, (48, 64, 3)).astype(np.uint8)

    msg = clouds.depth_to_cloud_msg(depth_m, rgb, WIDE, HEADER, clouds.CloudOptions(drop_sky=True))
    points_m, colors = clouds.cloud_from_msg(msg)

    hit = np.isfinite(depth_m)
    assert (msg.height, msg.width, msg.row_step) == (1, hit.sum(), 16 * hit.sum())
    assert msg.is_dense
    np.testing.assert_allclose(points_m[0], open3d_points(depth_m, WIDE), atol=1e-6)
    np.testing.assert_array_equal(colors[0], rgb[hit])
    none = np.full((48, 64), np.inf, np.float32)
    empty = clouds.depth_to_cloud_msg(none, rgb, WIDE, HEADER, clouds.CloudOptions(drop_sky=True))
    assert (empty.height, empty.width, len(empty.data)) == (1, 0, 0)


def test_the_cloud_of_a_fisheye_is_at_the_ranges_of_its_depth() -> None:
    lens = replace(WIDE, distortion=(0.01, 0.0, 0.0, 0.0), distortion_model="equidistant")
    camera = replace(lens, fx_px=14.0, fy_px=14.0)
    range_m = np.random.default_rng(3).uniform(1, 9, (48, 64)).astype(np.float32)

    points_m, _ = clouds.cloud_from_msg(clouds.depth_to_cloud_msg(range_m, None, camera, HEADER))

    np.testing.assert_allclose(np.linalg.norm(points_m, axis=-1), range_m, rtol=1e-6)
    np.testing.assert_allclose(points_m, depth_to_points(range_m, camera), atol=1e-5)
    assert points_m[..., 2].min() < -1


@pytest.mark.parametrize("bent", [(), (-0.05, 0.01, 0.002, -0.001, 0.0003)])
@pytest.mark.parametrize("stride", [2, 5, 64])
def test_a_cloud_of_every_few_pixels_has_the_points_that_the_whole_one_has_there(
    stride: int, bent: tuple[float, ...]
) -> None:
    rng = np.random.default_rng(7)
    depth_m = rng.uniform(1, 9, (48, 64)).astype(np.float32)
    rgb = rng.integers(0, 256, (48, 64, 3)).astype(np.uint8)
    camera = replace(WIDE, distortion=bent)
    options = clouds.CloudOptions(stride=stride)

    whole_m, colors = clouds.cloud_from_msg(clouds.depth_to_cloud_msg(depth_m, rgb, camera, HEADER))
    msg = clouds.depth_to_cloud_msg(depth_m, rgb, camera, HEADER, options)
    points_m, few = clouds.cloud_from_msg(msg)

    assert (msg.height, msg.width) == (-(-48 // stride), -(-64 // stride))
    np.testing.assert_array_equal(points_m, whole_m[::stride, ::stride])
    np.testing.assert_array_equal(few, colors[::stride, ::stride])


def test_a_cloud_ends_where_its_range_does() -> None:
    depth_m = np.tile(np.linspace(1, 9, 64, dtype=np.float32), (48, 1))
    inside = (depth_m >= 2.5) & (depth_m <= 6.0)

    msg = clouds.depth_to_cloud_msg(
        depth_m, None, WIDE, HEADER, clouds.CloudOptions(min_depth_m=2.5, max_depth_m=6.0)
    )
    points_m, _ = clouds.cloud_from_msg(msg)

    np.testing.assert_array_equal(np.isfinite(points_m[..., 2]), inside)
    assert np.isnan(points_m[~inside]).all()
    np.testing.assert_array_equal(points_m[inside][:, 2], depth_m[inside])
    dense = clouds.depth_to_cloud_msg(
        depth_m, None, WIDE, HEADER, clouds.CloudOptions(max_depth_m=6.0, drop_sky=True)
    )
    assert dense.width == (depth_m <= 6.0).sum()


@pytest.mark.parametrize(
    ("dtype", "channels", "encoding"),
    [
        (np.uint8, 1, "8UC1"),
        (np.uint8, 4, "8UC4"),
        (np.int8, 2, "8SC2"),
        (np.uint16, 3, "16UC3"),
        (np.int16, 1, "16SC1"),
        (np.uint32, 1, "32SC1"),
        (np.float32, 1, "32FC1"),
        (np.float64, 3, "64FC3"),
    ],
)
def test_images_of_installed_passes_have_an_encoding(
    dtype: type[np.generic], channels: int, encoding: str
) -> None:
    shape = (6, 8) if channels == 1 else (6, 8, channels)
    data = np.random.default_rng(8).integers(0, 100, shape).astype(dtype)

    assert conversions.opencv_encoding(data) == encoding
    back = conversions.image_from_msg(conversions.image_to_msg(data, encoding, HEADER))
    np.testing.assert_array_equal(back, data)


def test_pixels_that_no_encoding_describes_are_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"image\.data"):
        conversions.opencv_encoding(np.zeros((6, 8, 5), np.uint8))


def test_a_frustum_ends_in_the_corners_of_the_image() -> None:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", [0.3, -1.0, 0.4]).as_matrix()
    T[:3, 3] = (1.0, 2.0, 3.0)
    bent = replace(WIDE, distortion=(-0.05, 0.01, 0.002, -0.001, 0.0003))

    marker = trajectory_topics.frustum_to_marker(bent, T, 2.0, HEADER, ns="left", number=7)

    assert (marker.ns, marker.id, marker.header) == ("left", 7, HEADER)
    assert (marker.type, marker.action) == (Marker.LINE_LIST, Marker.ADD)
    pose = pose_to_matrix(conversions.pose_from_msg(marker.pose))
    np.testing.assert_allclose(pose, T, atol=1e-12)
    lines_m = np.array([(p.x, p.y, p.z) for p in marker.points]).reshape(-1, 2, 3)
    assert len(lines_m) == 8
    ends_m = np.unique(lines_m.reshape(-1, 3).round(9), axis=0)
    base_m = ends_m[np.linalg.norm(ends_m, axis=1) > 0]
    assert len(ends_m) == 5
    np.testing.assert_allclose(base_m[:, 2], 2.0)
    zero = np.zeros(3)
    pixels = cv2.projectPoints(base_m, zero, zero, WIDE.K, np.array(bent.distortion))[0][:, 0]
    corners = {(-0.5, -0.5), (63.5, -0.5), (-0.5, 47.5), (63.5, 47.5)}
    assert {(round(u, 6), round(v, 6)) for u, v in pixels.tolist()} == corners


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
