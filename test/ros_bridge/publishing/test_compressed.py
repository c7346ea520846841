"""Compressed images, read by the rules of ROS's image_transport plugins with OpenCV and Pillow."""

from __future__ import annotations

import io
import struct
from typing import Any

import cv2
import numpy as np
import pytest
from builtin_interfaces.msg import Time
from PIL import Image as PillowImage
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.publishing.compressed import (
    Compression,
    depth_error_bound_m,
    depth_to_compressed_msg,
    image_to_compressed_msg,
)

HEADER = Header(stamp=Time(sec=7, nanosec=9), frame_id="somewhere")
INVERSE_DEPTH = 0
COLORS = ("rgb8", "rgb16", "bgr8", "bgr16", "rgba8", "bgra8", "rgba16", "bgra16")


def read_compressed(msg: CompressedImage) -> tuple[str, np.ndarray]:
    """Decode as compressed_image_transport's subscriber does in its mode ``unchanged``."""
    encoding, rest = msg.format.split(";", 1)
    image = cv2.imdecode(np.frombuffer(msg.data, np.uint8), cv2.IMREAD_UNCHANGED)
    if encoding in COLORS and "compressed bgr" in rest and encoding == "rgb8":
        image = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    return encoding, image


def read_compressed_depth(msg: CompressedImage) -> np.ndarray:
    """Decode as compressed_depth_image_transport's subscriber does."""
    encoding, _, how = msg.format.partition(";")
    assert how == " compressedDepth png"
    kind, a, b = struct.unpack_from("<iff", msg.data)
    assert kind == INVERSE_DEPTH
    steps = cv2.imdecode(np.frombuffer(msg.data, np.uint8)[12:], cv2.IMREAD_UNCHANGED)
    assert steps.dtype == np.uint16
    if encoding == "16UC1":
        return steps
    depth_m = np.full(steps.shape, np.nan, np.float32)
    known = steps > 0
    depth_m[known] = np.float32(a) / (steps[known].astype(np.float32) - np.float32(b))
    return depth_m


def by_pillow(msg: CompressedImage) -> np.ndarray:
    return np.asarray(PillowImage.open(io.BytesIO(bytes(msg.data))))


def smooth_colors() -> np.ndarray:
    v, u = np.mgrid[0:48, 0:64]
    return np.stack([4 * u, 5 * v, 255 - 2 * u - 2 * v], axis=-1).clip(0, 255).astype(np.uint8)


def test_a_colour_image_as_jpeg() -> None:
    rgb = smooth_colors()

    msg = image_to_compressed_msg(rgb, "rgb8", HEADER, Compression(jpeg_quality=95))

    assert (msg.header, msg.format) == (HEADER, "rgb8; jpeg compressed bgr8")
    encoding, back = read_compressed(msg)
    assert encoding == "rgb8"
    assert np.abs(back.astype(int) - rgb).mean() < 2.0
    # Whoever reads it as any JPEG sees red as red.
    pillow = by_pillow(msg)
    assert np.abs(pillow.astype(int) - rgb).mean() < 2.0
    small = image_to_compressed_msg(rgb, "rgb8", HEADER, Compression(jpeg_quality=10))
    assert len(small.data) < len(msg.data)


@pytest.mark.parametrize("level", [0, 1, 9])
def test_a_colour_image_as_png_is_what_it_was(level: int) -> None:
    rgb = np.random.default_rng(1).integers(0, 256, (48, 64, 3)).astype(np.uint8)

    msg = image_to_compressed_msg(
        rgb, "rgb8", HEADER, Compression(color_format="png", png_level=level)
    )

    assert msg.format == "rgb8; png compressed bgr8"
    np.testing.assert_array_equal(read_compressed(msg)[1], rgb)
    np.testing.assert_array_equal(by_pillow(msg), rgb)


def test_labels_are_what_they_were() -> None:
    labels = np.random.default_rng(2).integers(0, 65536, (48, 64)).astype(np.uint16)

    msg = image_to_compressed_msg(labels, "16UC1", HEADER, Compression())

    assert msg.format == "16UC1; png compressed "
    encoding, back = read_compressed(msg)
    assert (encoding, back.dtype) == ("16UC1", np.uint16)
    np.testing.assert_array_equal(back, labels)
    np.testing.assert_array_equal(by_pillow(msg), labels)


@pytest.mark.parametrize("dtype", [np.int32, np.uint32])
def test_ids_are_what_they_were_beyond_sixteen_bits(dtype: type[Any]) -> None:
    ids = np.random.default_rng(3).integers(0, 2**31, (48, 64)).astype(dtype)

    msg = image_to_compressed_msg(ids, "32SC1", HEADER, Compression())

    assert msg.format == "32SC1; png compressed bgra8"
    encoding, back = read_compressed(msg)
    # cv_bridge makes an Image of it with this encoding and these bytes: the very ids.
    assert (encoding, back.shape) == ("32SC1", (48, 64, 4))
    np.testing.assert_array_equal(np.frombuffer(back.tobytes(), "<i4").reshape(48, 64), ids)
    r, g, b, a = np.moveaxis(by_pillow(msg), -1, 0)
    told = b.astype(np.int64) + (g.astype(np.int64) << 8) + (r.astype(np.int64) << 16)
    np.testing.assert_array_equal(told + (a.astype(np.int64) << 24), ids)


@pytest.mark.parametrize("encoding", ["32FC1", "32FC2", "32FC3", "mono8"])
def test_other_images_have_no_compressed_variant(encoding: str) -> None:
    with pytest.raises(InvalidInputError, match=r"image\.encoding"):
        image_to_compressed_msg(np.zeros((4, 4), np.float32), encoding, HEADER, Compression())


def random_depth(least_m: float, most_m: float) -> np.ndarray:
    rng = np.random.default_rng(4)
    return np.exp(rng.uniform(np.log(least_m), np.log(most_m), (240, 320))).astype(np.float32)


@pytest.mark.parametrize(
    ("quantization", "max_m", "least_m"),
    [(100.0, 10.0, 0.16), (100.0, 100.0, 0.16), (300.0, 400.0, 1.4)],
)
def test_quantised_depth_is_within_its_bound(
    quantization: float, max_m: float, least_m: float
) -> None:
    compression = Compression(depth_max_m=max_m, depth_quantization=quantization)
    depth_m = random_depth(least_m, 0.999 * max_m)

    msg = depth_to_compressed_msg(depth_m, HEADER, compression)

    assert (msg.header, msg.format) == (HEADER, "32FC1; compressedDepth png")
    _, a, b = struct.unpack_from("<iff", msg.data)
    assert a == pytest.approx(quantization * (quantization + 1))
    assert b == pytest.approx(1 - a / max_m)
    error_m = np.abs(read_compressed_depth(msg).astype(np.float64) - depth_m)
    # Half a step of the inverse: |dz| <= z^2 / (2 A - z); float32 holds a step to 1 %.
    z = depth_m.astype(np.float64)
    assert (error_m <= 1.01 * z**2 / (2 * a - z) + 1e-6).all()
    assert error_m.max() > 0.9 * (z.max() ** 2) / (2 * a - z.max()) * 0.5
    assert depth_error_bound_m(5.0, compression) == pytest.approx(25 / (2 * a - 5))


def test_depth_in_millimetres_is_within_half_of_one() -> None:
    compression = Compression(depth_encoding="16UC1", depth_max_m=60.0)
    depth_m = random_depth(0.05, 59.9)

    msg = depth_to_compressed_msg(depth_m, HEADER, compression)

    assert msg.format == "16UC1; compressedDepth png"
    error_m = np.abs(read_compressed_depth(msg) / 1000 - depth_m.astype(np.float64))
    assert error_m.max() <= depth_error_bound_m(1.0, compression) + 4e-6
    assert error_m.max() > 0.45e-3


@pytest.mark.parametrize("encoding", ["32FC1", "16UC1"])
def test_what_is_no_depth_comes_back_as_none(encoding: Any) -> None:
    compression = Compression(depth_encoding=encoding, depth_max_m=70.0)
    depth_m = np.array([[np.inf, -np.inf, np.nan, 0.0, -1.0, 71.0, 5.0]], np.float32)

    found = read_compressed_depth(depth_to_compressed_msg(depth_m, HEADER, compression))

    if encoding == "16UC1":
        np.testing.assert_array_equal(found, [[0, 0, 0, 0, 0, 0, 5000]])
    else:
        assert np.isnan(found[0, :6]).all()
        assert found[0, 6] == pytest.approx(5.0, abs=depth_error_bound_m(5.0, compression))


def test_depth_too_near_or_too_far_for_sixteen_bits_is_not_told_wrong() -> None:
    inverse = depth_to_compressed_msg(np.full((2, 2), 0.1, np.float32), HEADER, Compression())
    assert np.isnan(read_compressed_depth(inverse)).all()

    far = np.full((2, 2), 66.0, np.float32)
    whole = Compression(depth_encoding="16UC1", depth_max_m=100.0)
    assert not read_compressed_depth(depth_to_compressed_msg(far, HEADER, whole)).any()


def test_an_image_that_is_no_depth_is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"\(H, W\) float32"):
        depth_to_compressed_msg(np.zeros((4, 4), np.float64), HEADER, Compression())
