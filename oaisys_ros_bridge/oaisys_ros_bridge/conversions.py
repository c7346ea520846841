"""Pure conversions between the simulator's data and ROS messages, in pairs of inverses.

Large arrays enter messages as `array.array` straight from memory, by assignment and with
``check_fields``: anything else is taken element by element, a constructor's argument is copied
twice, and a message that does not check its fields copies what it is given.
"""

from __future__ import annotations

import array
import sys
from typing import Any, TypeVar

import numpy as np
from geometry_msgs.msg import Point, PoseStamped, Quaternion, TransformStamped, Vector3
from geometry_msgs.msg import Pose as PoseMsg
from nav_msgs.msg import Odometry
from numpy.typing import ArrayLike, NDArray
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import checked_pose, pose_from_matrix, pose_to_matrix
from oaisys_core.types import FloatArray, PinholeIntrinsics, Pose

T = TypeVar("T")

DTYPES_BY_ENCODING: dict[str, np.dtype[Any]] = {
    "rgb8": np.dtype(np.uint8),
    "32FC1": np.dtype(np.float32),
    "16UC1": np.dtype(np.uint16),
    "32SC1": np.dtype(np.int32),
}
"""Encodings of images that are published, with the type of a channel."""


def checked_type(value: object, expected: type[T], field: str) -> T:
    """Return ``value``; `TypeError` naming ``field`` where it is something else."""
    if not isinstance(value, expected):
        raise TypeError(f"{field}: received {type(value).__name__}, expected {expected.__name__}")
    return value


def buffer_of(data: NDArray[Any]) -> array.array[int]:
    """Return the bytes of ``data`` (any shape) as rclpy takes them without looking at each."""
    buffer = array.array("B")
    buffer.frombytes(np.ascontiguousarray(data).ravel().view(np.uint8).data)
    return buffer


def pose_to_msg(pose: Pose) -> PoseMsg:
    """Return the message of a pose; inverse: `pose_from_msg`."""
    checked_type(pose, Pose, "pose")
    (px, py, pz), (x, y, z, w) = pose.position_m, pose.quat_xyzw
    return PoseMsg(position=Point(x=px, y=py, z=pz), orientation=Quaternion(x=x, y=y, z=z, w=w))


def pose_from_msg(msg: PoseMsg, field: str = "pose") -> Pose:
    """Return the pose in a message, its quaternion normalised.

    Raises:
        TypeError: ``msg`` is no ``geometry_msgs/Pose``.
        InvalidInputError: A number is not finite, or the quaternion is not of unit length.
    """
    checked_type(msg, PoseMsg, field)
    p, q = msg.position, msg.orientation
    return checked_pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w), field)


def pose_to_stamped_msg(pose: Pose, header: Header) -> PoseStamped:
    """Return the stamped message of a pose in ``header``'s frame; inverse: `pose_from_msg`."""
    return PoseStamped(header=header, pose=pose_to_msg(pose))


def transform_to_msg(T_parent_child: ArrayLike, header: Header, child: str) -> TransformStamped:
    """Return the message of a (4, 4) transform; ``header`` names the parent frame."""
    pose = pose_to_msg(pose_from_matrix(T_parent_child))
    msg = TransformStamped(header=header, child_frame_id=child)
    p = pose.position
    msg.transform.translation = Vector3(x=p.x, y=p.y, z=p.z)
    msg.transform.rotation = pose.orientation
    return msg


def transform_from_msg(msg: TransformStamped) -> FloatArray:
    """Return ``T_parent_child`` (4, 4) of a message; inverse: `transform_to_msg`."""
    checked_type(msg, TransformStamped, "transform")
    t, q = msg.transform.translation, msg.transform.rotation
    return pose_to_matrix(checked_pose((t.x, t.y, t.z), (q.x, q.y, q.z, q.w), "transform"))


def odometry_to_msg(pose: Pose, header: Header, child_frame: str) -> Odometry:
    """Return the odometry of a body that stands still at ``pose``; inverse: `odometry_from_msg`."""
    msg = Odometry(header=header, child_frame_id=child_frame)
    msg.pose.pose = pose_to_msg(pose)
    return msg


def odometry_from_msg(msg: Odometry) -> Pose:
    """Return the pose in an odometry message."""
    return pose_from_msg(checked_type(msg, Odometry, "odometry").pose.pose, "odometry.pose")


def intrinsics_to_msg(intrinsics: PinholeIntrinsics, header: Header) -> CameraInfo:
    """Return the camera info of an undistorted pinhole camera; inverse: `intrinsics_from_msg`."""
    checked_type(intrinsics, PinholeIntrinsics, "intrinsics")
    K = intrinsics.K
    return CameraInfo(
        header=header,
        width=intrinsics.width_px,
        height=intrinsics.height_px,
        distortion_model="plumb_bob",
        d=[0.0] * 5,
        k=K.ravel(),
        r=np.eye(3).ravel(),
        p=np.column_stack((K, np.zeros(3))).ravel(),
    )


def intrinsics_from_msg(msg: CameraInfo) -> PinholeIntrinsics:
    """Return the pinhole camera of a message.

    Raises:
        TypeError: ``msg`` is no ``sensor_msgs/CameraInfo``.
        InvalidInputError: The camera is distorted, skewed, or not calibrated.
    """
    checked_type(msg, CameraInfo, "camera_info")
    K = np.asarray(msg.k).reshape(3, 3)
    if np.any(np.asarray(msg.d)):
        raise InvalidInputError("camera_info.d", list(msg.d), "no distortion")
    expected = np.array([[K[0, 0], 0.0, K[0, 2]], [0.0, K[1, 1], K[1, 2]], [0.0, 0.0, 1.0]])
    if not np.array_equal(K, expected) or K[0, 0] <= 0.0 or K[1, 1] <= 0.0:
        raise InvalidInputError("camera_info.k", K.tolist(), "fx 0 cx, 0 fy cy, 0 0 1")
    fx, fy, cx, cy = (float(K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return PinholeIntrinsics(msg.width, msg.height, fx, fy, cx, cy)


def image_to_msg(data: NDArray[Any], encoding: str, header: Header) -> Image:
    """Return the message of an image; inverse: `image_from_msg`.

    Args:
        data: (H, W, 3) for ``rgb8``, else (H, W); of the encoding's type. ``32SC1`` also takes
            uint32, whose values must fit.
        encoding: One of `DTYPES_BY_ENCODING`.
        header: Stamp and frame.

    Raises:
        TypeError: ``data`` is no array.
        InvalidInputError: Unknown encoding, or data of another shape, type or range.
    """
    checked_type(data, np.ndarray, "image.data")
    dtype = _dtype_of(encoding)
    if encoding == "32SC1" and data.dtype == np.uint32:
        if data.size and int(data.max()) > np.iinfo(np.int32).max:
            raise InvalidInputError("image.data", int(data.max()), "ids that fit 31 bits")
        data = data.view(np.int32)
    shape_is_right = data.ndim == 2 if encoding != "rgb8" else data.shape[2:] == (3,)
    if data.dtype != dtype or not shape_is_right:
        form = "(H, W, 3)" if encoding == "rgb8" else "(H, W)"
        raise InvalidInputError("image.data", (data.shape, str(data.dtype)), f"{form} {dtype}")
    height, width = data.shape[:2]
    step = data.itemsize * width * (3 if encoding == "rgb8" else 1)
    msg = Image(
        header=header,
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=int(sys.byteorder == "big"),
        step=step,
        check_fields=True,
    )
    msg.data = buffer_of(data)
    return msg


def image_from_msg(msg: Image) -> NDArray[Any]:
    """Return the (H, W, 3) or (H, W) array of an image; it shares the message's memory.

    Raises:
        TypeError: ``msg`` is no ``sensor_msgs/Image``.
        InvalidInputError: Unknown encoding, or sizes that do not agree with each other.
    """
    checked_type(msg, Image, "image")
    dtype: np.dtype[Any] = _dtype_of(msg.encoding).newbyteorder(">" if msg.is_bigendian else "<")
    channels = 3 if msg.encoding == "rgb8" else 1
    row_bytes = dtype.itemsize * channels * msg.width
    if msg.step < row_bytes or len(msg.data) != msg.step * msg.height:
        received = {"step": msg.step, "bytes": len(msg.data)}
        expected = f"step of at least {row_bytes} bytes and {msg.height} rows of it"
        raise InvalidInputError("image.data", received, expected)
    rows = np.frombuffer(msg.data, dtype=np.uint8).reshape(msg.height, msg.step)[:, :row_bytes]
    pixels = np.ascontiguousarray(rows).view(dtype)
    return pixels.reshape(msg.height, msg.width, 3) if channels == 3 else pixels


def _dtype_of(encoding: str) -> np.dtype[Any]:
    if encoding not in DTYPES_BY_ENCODING:
        raise InvalidInputError(
            "image.encoding", encoding, "one of " + ", ".join(DTYPES_BY_ENCODING)
        )
    return DTYPES_BY_ENCODING[encoding]
