"""Every encoding gives back every bit; what it makes is read by decoders that are not ours."""

import io
import struct
import zlib
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_grpc.contract import arrays
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

LIMIT = 1 << 30
TYPES = ["u1", "u2", "u4", "i4", "f4", "f8"]
PNG_KINDS = [("u1", (3,)), ("u1", ()), ("u2", ()), ("u4", ())]

BOUNDED = settings(max_examples=60, deadline=None)


def bits(dtype: np.dtype[Any], shape: tuple[int, ...]) -> st.SearchStrategy[Any]:
    """Arrays of any bit pattern, NaN with payloads among them."""
    words = np.dtype(f"u{dtype.itemsize}")
    return hnp.arrays(words, shape).map(lambda array: array.view(dtype))


ARRAYS = st.builds(np.dtype, st.sampled_from(TYPES)).flatmap(
    lambda dtype: hnp.array_shapes(min_dims=1, max_dims=3, max_side=9).flatmap(
        lambda shape: bits(dtype, shape)
    )
)
IMAGES = st.sampled_from(PNG_KINDS).flatmap(
    lambda kind: st.tuples(st.integers(1, 40), st.integers(1, 40)).flatmap(
        lambda size: bits(np.dtype(kind[0]), (*size, *kind[1]))
    )
)


def smooth(dtype: str, shape: tuple[int, ...]) -> Any:
    """An image that can be made smaller."""
    return (np.indices(shape).sum(axis=0) // 7).astype(dtype)


def carried(array: Any, accepted: Sequence[Any]) -> tuple[pb.ArrayHeader, Any]:
    """The header and the array as they arrive."""
    header, data = arrays.encode(array, accepted)
    assert data.size == header.byte_size
    header = pb.ArrayHeader.FromString(header.SerializeToString())
    assert arrays.check_nbytes(header, LIMIT) == array.nbytes
    return header, arrays.decode(header, np.frombuffer(data.tobytes(), np.uint8))


def assert_same_bits(a: Any, b: Any) -> None:
    assert (a.dtype, a.shape) == (b.dtype, b.shape)
    assert a.tobytes() == b.tobytes()


@given(ARRAYS)
@BOUNDED
def test_any_array_comes_back_bit_for_bit(array: Any) -> None:
    for accepted in ([], [pb.ENCODING_PNG], [pb.ENCODING_SHUFFLED_ZLIB], [99, *arrays.CODECS]):
        _, back = carried(array, accepted)
        assert_same_bits(back, array)


@pytest.mark.parametrize("encoding", list(arrays.CODECS))
@given(array=IMAGES)
@BOUNDED
def test_a_codec_loses_nothing_even_where_it_gains_nothing(encoding: int, array: Any) -> None:
    codec = arrays.CODECS[encoding]
    data = codec.encoded(array)
    assert data is not None
    assert_same_bits(codec.decoded(data, array.dtype, array.shape), array)


@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_special_floats_keep_their_bits(dtype: str) -> None:
    kind = np.finfo(dtype)
    values = [np.inf, -np.inf, np.nan, -np.nan, 0.0, -0.0, kind.tiny, kind.smallest_subnormal]
    array = np.tile(np.array([*values, kind.max, kind.min], dtype), (10, 100))
    header, back = carried(array, [pb.ENCODING_SHUFFLED_ZLIB])
    assert header.encoding == pb.ENCODING_SHUFFLED_ZLIB
    assert_same_bits(back, array)


@pytest.mark.parametrize("dtype", TYPES)
def test_zlib_and_the_words_of_the_proto_are_enough_to_decode(dtype: str) -> None:
    array = smooth(dtype, (30, 50)) * np.array(3, dtype)
    header, data = arrays.encode(array, [pb.ENCODING_SHUFFLED_ZLIB])
    assert header.encoding == pb.ENCODING_SHUFFLED_ZLIB
    planes = zlib.decompress(data.tobytes())
    count, size = array.size, array.itemsize
    raw = bytes(planes[s * count + n] for n in range(count) for s in range(size))
    assert raw == array.astype(f"<{dtype}").tobytes()


@pytest.mark.parametrize(("dtype", "channels"), PNG_KINDS)
def test_others_read_our_png_files(dtype: str, channels: tuple[int, ...]) -> None:
    array = smooth(dtype, (40, 60, *channels)) * np.array(1 if dtype == "u1" else 263, dtype)
    if dtype == "u4":
        array += np.uint32(200 << 24)
    header, data = arrays.encode(array, [pb.ENCODING_PNG])
    assert header.encoding == pb.ENCODING_PNG
    pixels = np.asarray(Image.open(io.BytesIO(data.tobytes())))
    if dtype == "u4":
        assert pixels.shape == (40, 60, 4)
        parts = pixels.astype(np.uint64)
        pixels = parts @ np.array([1, 256, 65536, 16777216], np.uint64)
    assert np.array_equal(pixels, array)
    again = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    assert again is not None
    assert again.shape[:2] == (40, 60)


def test_png_files_of_others_are_read() -> None:
    """Other encoders choose other filters."""
    rng = np.random.default_rng(5)
    rgb = (rng.integers(0, 9, (50, 70, 3)) + np.arange(70)[None, :, None]).astype(np.uint8)
    for level in (1, 9):
        file = io.BytesIO()
        Image.fromarray(rgb).save(file, "PNG", compress_level=level, optimize=level == 9)
        codec = arrays.CODECS[pb.ENCODING_PNG]
        assert_same_bits(codec.decoded(file.getvalue(), rgb.dtype, rgb.shape), rgb)


def test_the_first_encoding_that_makes_it_smaller_is_taken() -> None:
    both = [pb.ENCODING_PNG, pb.ENCODING_SHUFFLED_ZLIB]
    noise = np.random.default_rng(1).integers(0, 256, (40, 40, 3), dtype=np.uint8)
    assert carried(noise, both)[0].encoding == pb.ENCODING_RAW
    assert carried(smooth("u1", (40, 40, 3)), both)[0].encoding == pb.ENCODING_PNG
    assert carried(smooth("f4", (40, 40)), both)[0].encoding == pb.ENCODING_SHUFFLED_ZLIB
    assert carried(smooth("f4", (40, 40)), [77])[0].encoding == pb.ENCODING_RAW


def header_of(array: Any, encoding: Any, size: int) -> pb.ArrayHeader:
    header = arrays.raw_header(array)
    header.encoding, header.byte_size = encoding, size
    return header


@pytest.mark.parametrize("encoding", [pb.ENCODING_RAW, *arrays.CODECS])
def test_what_is_announced_is_checked_before_anything_is_allocated(encoding: Any) -> None:
    image = np.zeros((4, 4), np.uint16)
    header = header_of(image, encoding, 10**15)
    with pytest.raises(OaisysError, match="is not 1000000000000000 bytes"):
        arrays.check_nbytes(header, LIMIT)
    header = header_of(image, encoding, 32)
    header.shape[:] = [2**40, 2**40]
    header.byte_size = 2**63
    with pytest.raises(OaisysError, match="this client takes 1073741824 at most"):
        arrays.check_nbytes(header, LIMIT)
    header = header_of(image, encoding, 32)
    with pytest.raises(OaisysError, match="this client takes 31 at most"):
        arrays.check_nbytes(header, 31)
    header.data_type = pb.DATA_TYPE_UNSPECIFIED
    with pytest.raises(OaisysError, match="cannot read"):
        arrays.check_nbytes(header, LIMIT)
    header = header_of(image, 57, 32)
    with pytest.raises(OaisysError, match="encoding 57"):
        arrays.check_nbytes(header, LIMIT)


def bomb() -> bytes:
    """100 MB in 100 kB."""
    return zlib.compress(bytes(100_000_000), 9)


def png(width: int, height: int) -> bytes:
    """A tiny PNG file that says to be large."""
    chunk = b"IHDR" + struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    size, checksum = struct.pack(">I", 13), struct.pack(">I", zlib.crc32(chunk))
    return b"\x89PNG\r\n\x1a\n" + size + chunk + checksum


@pytest.mark.parametrize(
    ("encoding", "data"),
    [
        (pb.ENCODING_SHUFFLED_ZLIB, bomb()),
        (pb.ENCODING_SHUFFLED_ZLIB, zlib.compress(bytes(31))),
        (pb.ENCODING_SHUFFLED_ZLIB, zlib.compress(bytes(32))[:-1]),
        (pb.ENCODING_SHUFFLED_ZLIB, zlib.compress(bytes(32)) + b"x"),
        (pb.ENCODING_SHUFFLED_ZLIB, b"no zlib"),
        (pb.ENCODING_SHUFFLED_ZLIB, b""),
        (pb.ENCODING_PNG, png(30_000, 30_000)),
        (pb.ENCODING_PNG, png(4, 4)),
        (pb.ENCODING_PNG, b"no PNG"),
        (pb.ENCODING_PNG, b""),
    ],
)
def test_bytes_that_are_not_the_array_are_refused(encoding: Any, data: bytes) -> None:
    header = header_of(np.zeros((4, 4), np.uint16), encoding, len(data))
    with pytest.raises(OaisysError):
        arrays.decode(header, np.frombuffer(data, np.uint8))


def test_an_encoding_that_there_is_not_is_refused_by_name() -> None:
    with pytest.raises(InvalidInputError) as refused:
        arrays.encodings_from_names(["png", "jpeg"])
    assert (refused.value.field, refused.value.received) == ("encodings", "jpeg")
