"""Conversions between the simulator's data and ROS messages, in pairs of inverses; no node needed.

Large arrays are assigned to messages as `array.array`, with ``check_fields``. rclpy copies any
other sequence element by element. It copies such an argument of a constructor twice. Without
``check_fields`` it makes one more copy.
"""

from __future__ import annotations

import array
import sys
from typing import Any, NamedTuple, TypeVar

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, PoseStamped, Quaternion, TransformStamped, Vector3
from geometry_msgs.msg import Pose as PoseMsg
from numpy.typing import ArrayLike, NDArray
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import check_pose, is_invertible, pose_from_matrix, pose_to_matrix
from oaisys_core.types import (
    BAYER,
    EQUIDISTANT,
    PLUMB_BOB,
    FloatArray,
    PinholeIntrinsics,
    Pose,
)

T = TypeVar("T")

COEFFICIENTS = {PLUMB_BOB: 5, EQUIDISTANT: 4}
"""Number of coefficients by distortion model."""


class PixelFormat(NamedTuple):
    """Type and number of channels of an encoding's pixels."""

    dtype: np.dtype[Any]
    channels: int

    @property
    def form(self) -> str:
        """Shape and type of an image, in words."""
        shape = "(H, W)" if self.channels == 1 else f"(H, W, {self.channels})"
        return f"{shape} {self.dtype}"


OPENCV_TYPES: dict[str, np.dtype[Any]] = {
    "8U": np.dtype(np.uint8),
    "8S": np.dtype(np.int8),
    "16U": np.dtype(np.uint16),
    "16S": np.dtype(np.int16),
    "32S": np.dtype(np.int32),
    "32F": np.dtype(np.float32),
    "64F": np.dtype(np.float64),
}
"""Pixel types by their names in OpenCV."""
MAX_CHANNELS = 4
MAX_PIXELS = 65_536
"""Width and height of an image."""

_CHANNELS = {"mono": 1, "rgb": 3, "bgr": 3, "rgba": 4, "bgra": 4}
_CHANNELS |= {f"bayer_{mosaic}": 1 for mosaic in BAYER.values()}

FORMAT_BY_ENCODING: dict[str, PixelFormat] = {
    **{
        f"{name}{8 * dtype.itemsize}": PixelFormat(dtype, channels)
        for name, channels in _CHANNELS.items()
        for dtype in (np.dtype(np.uint8), np.dtype(np.uint16))
    },
    **{
        f"{name}C{channels}": PixelFormat(dtype, channels)
        for name, dtype in OPENCV_TYPES.items()
        for channels in range(1, MAX_CHANNELS + 1)
    },
}
"""Encodings of ``sensor_msgs/image_encodings``, but for those that share values between pixels."""

COLOR_ORDERS = {
    "rgb8": [0, 1, 2],
    "bgr8": [2, 1, 0],
    "rgba8": [0, 1, 2],
    "bgra8": [2, 1, 0],
    "mono8": [0, 0, 0],
}
"""Indices of red, green and blue among the channels of a colour image."""

NS_PER_S = 1_000_000_000


def opencv_encoding(data: NDArray[Any]) -> str:
    """Return the encoding, such as ``8UC1``, of an (H, W) or (H, W, channels) image.

    Raises:
        InvalidInputError: No encoding has such pixels.
    """
    channels = 1 if data.ndim == 2 else data.shape[-1]
    dtype = np.dtype(np.int32) if data.dtype == np.uint32 else data.dtype
    for name, each in OPENCV_TYPES.items():
        if each == dtype and 1 <= channels <= MAX_CHANNELS:
            return f"{name}C{channels}"
    expected = f"up to {MAX_CHANNELS} channels of {', '.join(map(str, OPENCV_TYPES.values()))}"
    raise InvalidInputError("image.data", (data.shape, str(data.dtype)), expected)


def check_type(value: object, expected: type[T], field: str) -> T:
    """Return ``value``; raise `TypeError` naming ``field`` if it is of another type."""
    if not isinstance(value, expected):
        raise TypeError(f"{field}: received {type(value).__name__}, expected {expected.__name__}")
    return value


def buffer_of(data: NDArray[Any]) -> array.array[int]:
    """Return the bytes of ``data`` (any shape) in the type that rclpy does not check bytewise."""
    return array_of("B", np.ascontiguousarray(data).ravel().view(np.uint8))


def array_of(code: str, data: NDArray[Any]) -> array.array[Any]:
    """Return numbers in the type that rclpy does not check one by one.

    Args:
        code: Their type, as `array.array` names it.
        data: Any shape, of that type.
    """
    values: array.array[Any] = array.array(code)
    values.frombytes(np.ascontiguousarray(data).ravel().view(np.uint8).data)
    return values


def nanoseconds(stamp: Time) -> int:
    """Return a stamp as one number; inverse: `stamp_from_nanoseconds`."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def stamp_from_nanoseconds(stamp_ns: int) -> Time:
    """Return the stamp of nanoseconds since the epoch, 0 or more."""
    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    return Time(sec=sec, nanosec=nanosec)


def duration_from_seconds(seconds: float) -> Duration:
    """Return a duration, to the nanosecond."""
    whole, rest = divmod(round(seconds * NS_PER_S), NS_PER_S)
    return Duration(sec=whole, nanosec=rest)


def pose_to_msg(pose: Pose) -> PoseMsg:
    """Return the message of a pose; inverse: `pose_from_msg`."""
    check_type(pose, Pose, "pose")
    (px, py, pz), (x, y, z, w) = pose.position_m, pose.quat_xyzw
    return PoseMsg(position=Point(x=px, y=py, z=pz), orientation=Quaternion(x=x, y=y, z=z, w=w))


def pose_from_msg(msg: PoseMsg, field: str = "pose") -> Pose:
    """Return the pose in a message, its quaternion normalised.

    Raises:
        TypeError: ``msg`` is not a ``geometry_msgs/Pose``.
        InvalidInputError: A number is not finite, or the quaternion is not of unit length.
    """
    check_type(msg, PoseMsg, field)
    p, q = msg.position, msg.orientation
    return check_pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w), field)


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
    check_type(msg, TransformStamped, "transform")
    t, q = msg.transform.translation, msg.transform.rotation
    return pose_to_matrix(check_pose((t.x, t.y, t.z), (q.x, q.y, q.z, q.w), "transform"))


def intrinsics_to_msg(
    intrinsics: PinholeIntrinsics, header: Header, baseline_m: float = 0.0
) -> CameraInfo:
    """Return the camera info of a camera; inverse: `intrinsics_from_msg`.

    P projects to the rectified image, which has the same K, from the frame that ``header`` names.
    With a ``baseline_m`` that is the frame of the left camera of a stereo pair, whose right camera
    this is (``CameraInfo.msg``); without one it is the camera's own.
    """
    check_type(intrinsics, PinholeIntrinsics, "intrinsics")
    K = intrinsics.K
    to_left = np.array((-K[0, 0] * baseline_m, 0.0, 0.0)) if baseline_m else np.zeros(3)
    return CameraInfo(
        header=header,
        width=intrinsics.width_px,
        height=intrinsics.height_px,
        distortion_model=intrinsics.distortion_model,
        d=list(intrinsics.distortion) or [0.0] * COEFFICIENTS[intrinsics.distortion_model],
        k=K.ravel(),
        r=np.eye(3).ravel(),
        p=np.column_stack((K, to_left)).ravel(),
    )


def intrinsics_from_msg(msg: CameraInfo) -> PinholeIntrinsics:
    """Return the camera of a message.

    Raises:
        TypeError: ``msg`` is not a ``sensor_msgs/CameraInfo``.
        InvalidInputError: The camera is skewed or not calibrated, or its distortion is neither of
            the model plumb_bob nor equidistant, or not invertible.
    """
    check_type(msg, CameraInfo, "camera_info")
    if not np.isfinite([*msg.k, *msg.d]).all():
        raise InvalidInputError("camera_info", [*msg.k, *msg.d], "finite numbers in k and d")
    if not (0 < msg.width <= MAX_PIXELS and 0 < msg.height <= MAX_PIXELS):
        size = (msg.width, msg.height)
        raise InvalidInputError("camera_info", size, f"1 to {MAX_PIXELS} pixels a side")
    K = np.asarray(msg.k).reshape(3, 3)
    distortion = tuple(float(value) for value in msg.d) if np.any(np.asarray(msg.d)) else ()
    model = EQUIDISTANT if msg.distortion_model == EQUIDISTANT else PLUMB_BOB
    if distortion and (msg.distortion_model != model or len(distortion) != COEFFICIENTS[model]):
        received = (msg.distortion_model, list(distortion))
        models = "plumb_bob with k1, k2, p1, p2, k3, or equidistant with k1 to k4"
        raise InvalidInputError("camera_info.d", received, models)
    expected = np.array([[K[0, 0], 0.0, K[0, 2]], [0.0, K[1, 1], K[1, 2]], [0.0, 0.0, 1.0]])
    if not np.array_equal(K, expected) or K[0, 0] <= 0.0 or K[1, 1] <= 0.0:
        raise InvalidInputError("camera_info.k", K.tolist(), "fx 0 cx, 0 fy cy, 0 0 1")
    fx, fy, cx, cy = (float(K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    intrinsics = PinholeIntrinsics(msg.width, msg.height, fx, fy, cx, cy, distortion, model)
    if not is_invertible(intrinsics):
        raise InvalidInputError("camera_info.d", list(distortion), "distortion without a fold")
    return intrinsics


def image_to_msg(data: NDArray[Any], encoding: str, header: Header) -> Image:
    """Return the message of an image; inverse: `image_from_msg`.

    Args:
        data: Of the shape and type in `FORMAT_BY_ENCODING`; for ``32SC1`` also uint32 that fit.
        encoding: One of `FORMAT_BY_ENCODING`.
        header: Stamp and frame.

    Raises:
        TypeError: ``data`` is not an array.
        InvalidInputError: Unknown encoding, or data of another shape, type or range.
    """
    check_type(data, np.ndarray, "image.data")
    pixels = _format_of(encoding)
    if encoding == "32SC1" and data.dtype == np.uint32:
        if data.size and int(data.max()) > np.iinfo(np.int32).max:
            raise InvalidInputError("image.data", int(data.max()), "ids that fit 31 bits")
        data = data.view(np.int32)
    channels = data.shape[2:] if pixels.channels > 1 else (1,) * (data.ndim == 2)
    if data.dtype != pixels.dtype or channels != (pixels.channels,):
        raise InvalidInputError("image.data", (data.shape, str(data.dtype)), pixels.form)
    height, width = data.shape[:2]
    step = data.itemsize * width * pixels.channels
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
    """Return the (H, W, channels) or (H, W) array of an image, in this machine's order of bytes.

    It shares the message's memory if that has the same order.

    Raises:
        TypeError: ``msg`` is not a ``sensor_msgs/Image``.
        InvalidInputError: Unknown encoding, or sizes that do not agree with each other.
    """
    check_type(msg, Image, "image")
    if not (0 < msg.width <= MAX_PIXELS and 0 < msg.height <= MAX_PIXELS):
        size = (msg.width, msg.height)
        raise InvalidInputError("image", size, f"1 to {MAX_PIXELS} pixels a side")
    plain, channels = _format_of(msg.encoding)
    dtype: np.dtype[Any] = plain.newbyteorder(">" if msg.is_bigendian else "<")
    row_bytes = dtype.itemsize * channels * msg.width
    if msg.step < row_bytes or len(msg.data) != msg.step * msg.height:
        received = {"step": msg.step, "bytes": len(msg.data)}
        expected = f"step of at least {row_bytes} bytes and {msg.height} rows of it"
        raise InvalidInputError("image.data", received, expected)
    rows = np.frombuffer(msg.data, dtype=np.uint8).reshape(msg.height, msg.step)[:, :row_bytes]
    pixels = np.ascontiguousarray(rows).view(dtype).astype(plain, copy=False)
    return pixels.reshape(msg.height, msg.width, channels) if channels > 1 else pixels


def depth_from_msg(msg: Image) -> NDArray[np.float32]:
    """Return (H, W) float32 metres of a depth image: ``32FC1``, or ``16UC1`` in millimetres.

    A 0 in millimetres, which means that nothing was measured (REP-118), becomes NaN.

    Raises:
        InvalidInputError: Another encoding.
    """
    image = image_from_msg(msg)
    if msg.encoding == "16UC1":
        depth_m = image.astype(np.float32) * np.float32(1e-3)
        depth_m[image == 0] = np.nan
        return depth_m
    if msg.encoding != "32FC1":
        raise InvalidInputError("depth.encoding", msg.encoding, "32FC1 or 16UC1")
    return np.asarray(image, np.float32)


def color_from_msg(msg: Image) -> NDArray[np.uint8]:
    """Return (H, W, 3) uint8 red, green and blue of an image in one of `COLOR_ORDERS`.

    Raises:
        InvalidInputError: Another encoding.
    """
    if msg.encoding not in COLOR_ORDERS:
        raise InvalidInputError("color.encoding", msg.encoding, f"one of {', '.join(COLOR_ORDERS)}")
    image = image_from_msg(msg)
    channels = image[..., None] if image.ndim == 2 else image
    return np.ascontiguousarray(channels[..., COLOR_ORDERS[msg.encoding]])


def _format_of(encoding: str) -> PixelFormat:
    if encoding not in FORMAT_BY_ENCODING:
        expected = "one of " + ", ".join(FORMAT_BY_ENCODING)
        raise InvalidInputError("image.encoding", encoding, expected)
    return FORMAT_BY_ENCODING[encoding]
