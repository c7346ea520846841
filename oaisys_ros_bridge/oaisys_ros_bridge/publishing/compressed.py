"""Compressed images in the formats of ROS's image_transport plugins, without those plugins.

``compressed``: a JPEG or PNG file; the message's format begins with the encoding of the image.
``compressedDepth``: twelve bytes (int32 0, float32 A, float32 B), then a PNG of 16 bits per pixel.
Its values are depth in millimetres or, if the format begins with ``32FC1``, q = A / z + B rounded,
from which z = A / (q - B). 0 is no measurement. The error of z by rounding is at most
``depth_error_bound_m``.
"""

from __future__ import annotations

import array
import struct
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.conversions import check_type

DepthEncoding = Literal["32FC1", "16UC1"]
ColorFormat = Literal["jpeg", "png"]

INVERSE_DEPTH = 0
"""The only compression kind in a compressedDepth header."""
CONFIG_HEADER = struct.Struct("<iff")
MAX_UINT16 = 65535
MM_PER_M = 1000.0

COLORS = frozenset({"rgb8"})
LABELS = frozenset({"16UC1"})
IDS = frozenset({"32SC1"})
"""Encodings of images that have compressed variants."""


@dataclass(frozen=True)
class Compression:
    """Options of compression.

    Attributes:
        color_format: Of colour; labels and ids are always PNG, which is lossless.
        jpeg_quality: 1 to 100.
        png_level: 0 (fast) to 9 (small).
        depth_encoding: ``32FC1`` rounds inverse depth, ``16UC1`` rounds depth to millimetres.
        depth_max_m: Greater depth is sent as no measurement.
        depth_quantization: Greater is finer; but depth below about its square divided by 65,535
            (m) is sent as no measurement.
    """

    color_format: ColorFormat = "jpeg"
    jpeg_quality: int = 95
    png_level: int = 1
    depth_encoding: DepthEncoding = "32FC1"
    depth_max_m: float = 100.0
    depth_quantization: float = 100.0

    @property
    def quantization(self) -> tuple[float, float]:
        """A and B of the module's docstring, as float32 holds them."""
        z0 = np.float32(self.depth_quantization)
        a = z0 * (z0 + np.float32(1))
        return float(a), float(np.float32(1) - a / np.float32(self.depth_max_m))


def depth_error_bound_m(depth_m: float, compression: Compression) -> float:
    """Return the largest error of a depth by compression, in m, besides rounding to float32."""
    if compression.depth_encoding == "16UC1":
        return 0.5 / MM_PER_M
    a, _ = compression.quantization
    return 0.5 * depth_m**2 / (a - 0.5 * depth_m)


def image_to_compressed_msg(
    data: NDArray[Any], encoding: str, header: Header, compression: Compression
) -> CompressedImage:
    """Return the message of topic ``…/compressed``.

    Args:
        data: (H, W, 3) uint8 for ``rgb8``, (H, W) uint16 for ``16UC1``; (H, W) int32 or uint32 for
            ``32SC1``, whose four bytes become the blue, green, red and alpha of a PNG.
        encoding: Encoding of the raw image.
        header: Stamp and frame.
        compression: Options.

    Raises:
        InvalidInputError: Images of this encoding are not compressed.
    """
    check_type(data, np.ndarray, "image.data")
    if encoding in COLORS:
        kind = compression.color_format
        pixels, target = cv2.cvtColor(data, cv2.COLOR_RGB2BGR), "bgr8"
    elif encoding in LABELS:
        kind, pixels, target = "png", data, ""
    elif encoding in IDS:
        ids = np.ascontiguousarray(data).astype("<u4", copy=False)
        kind, pixels, target = "png", ids.view(np.uint8).reshape(*ids.shape, 4), "bgra8"
    else:
        expected = "one of " + ", ".join(sorted(COLORS | LABELS | IDS))
        raise InvalidInputError("image.encoding", encoding, expected)
    file = _encode(pixels, kind, compression)
    return _message(header, f"{encoding}; {kind} compressed {target}", file)


def depth_to_compressed_msg(
    depth_m: NDArray[np.float32], header: Header, compression: Compression
) -> CompressedImage:
    """Return the message of topic ``…/compressedDepth`` for an (H, W) float32 image in metres."""
    check_type(depth_m, np.ndarray, "image.data")
    if depth_m.ndim != 2 or depth_m.dtype != np.float32:
        raise InvalidInputError("image.data", (depth_m.shape, str(depth_m.dtype)), "(H, W) float32")
    a, b = compression.quantization
    with np.errstate(divide="ignore", invalid="ignore"):
        if compression.depth_encoding == "32FC1":
            steps = np.float32(a) / depth_m
            steps += np.float32(b)
        else:
            steps = depth_m * np.float32(MM_PER_M)
        np.rint(steps, out=steps)
        known = (depth_m > 0) & (depth_m < np.float32(compression.depth_max_m))
        known &= steps <= MAX_UINT16
    steps[~known] = 0
    file = _encode(steps.astype(np.uint16), "png", compression)
    head = CONFIG_HEADER.pack(INVERSE_DEPTH, a, b)
    return _message(header, f"{compression.depth_encoding}; compressedDepth png", file, head)


def _encode(pixels: NDArray[Any], kind: ColorFormat, compression: Compression) -> NDArray[np.uint8]:
    if kind == "jpeg":
        options = [cv2.IMWRITE_JPEG_QUALITY, compression.jpeg_quality]
    else:
        options = [cv2.IMWRITE_PNG_COMPRESSION, compression.png_level]
    done, file = cv2.imencode(f".{kind}", pixels, options)
    if not done:
        raise InvalidInputError("image.data", (pixels.shape, str(pixels.dtype)), f"a {kind} image")
    encoded: NDArray[np.uint8] = file
    return encoded


def _message(
    header: Header, image_format: str, file: NDArray[np.uint8], head: bytes = b""
) -> CompressedImage:
    message = CompressedImage(header=header, format=image_format, check_fields=True)
    data = array.array("B", head)
    data.frombytes(file.data)
    message.data = data
    return message
