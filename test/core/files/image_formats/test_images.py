"""Images that are small as files and huge in memory, and files that point elsewhere."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import psutil
import pytest
import rasterio
from PIL import ExifTags, Image, ImageOps
from rasterio.io import MemoryFile

from oaisys_core.config.sections.density import ImageDensity
from oaisys_core.config.sections.environment import HdriImageConfig, SkyLabelsConfig
from oaisys_core.config.sections.stage import DemConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.arrays import load_arrays
from oaisys_core.files.documents import DocumentError
from oaisys_core.files.image_formats.image_headers import image_size
from oaisys_core.files.image_formats.image_use import (
    ELEVATION,
    FRAME,
    MESH_TEXTURE,
    SKY,
    TEXTURE,
    USES,
    ImageUse,
)
from oaisys_core.files.image_formats.images import decode_pixels, read_pixels
from oaisys_core.files.image_formats.radiance import radiance_header
from oaisys_core.files.image_formats.rasters import open_geotiff
from oaisys_core.output import exr
from oaisys_core.output.images import decode_image
from oaisys_core.procedural.environment.hdri import SkyImages, read_radiance
from oaisys_core.procedural.scatter.placement.density import _image as density_image
from oaisys_core.procedural.terrain import dem
from oaisys_core.procedural.textures.folder import load_texture_folder
from oaisys_core.procedural.textures.label_image import load_label_image
from oaisys_core.procedural.textures.map_pixels import read_map
from oaisys_core.world.stage_store import load_stage

SIDE = 60_000
MUCH_BYTES = 300_000_000


def png(width: int = SIDE, height: int = SIDE, depth: int = 16) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        sum_ = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + sum_

    head = struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0)
    rows = chunk(b"IDAT", zlib.compress(bytes(100_000)))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + rows + chunk(b"IEND", b"")


def tiff(**options: Any) -> bytes:
    size = {"width": SIDE, "height": SIDE, "count": 1, "dtype": "float32", **options}
    with MemoryFile() as memory:
        memory.open(driver="GTiff", sparse_ok=True, compress="deflate", **size).close()
        return bytes(memory.getbuffer())


def hdr() -> bytes:
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 30000 +X 60000\n" + bytes(1000)


def exr_file() -> bytes:
    """An EXR image whose data window is 60000 x 30000 only in its header."""
    stream = io.BytesIO()
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Y": np.zeros((2, 3), np.float32)}) as file:
        file.write(stream)
    small, large = struct.pack("<4i", 0, 0, 2, 1), struct.pack("<4i", 0, 0, 59_999, 29_999)
    return stream.getvalue().replace(small, large)


def jpeg() -> bytes:
    data = bytearray(cv2.imencode(".jpg", np.zeros((8, 8), np.uint8))[1].tobytes())
    place = data.index(b"\xff\xc0")
    data[place + 5 : place + 9] = struct.pack(">HH", SIDE, SIDE)
    return bytes(data)


def webp() -> bytes:
    data = bytearray(cv2.imencode(".webp", np.zeros((8, 8, 3), np.uint8))[1].tobytes())
    assert data[12:16] in (b"VP8 ", b"VP8L")
    extended = b"VP8X" + struct.pack("<I", 10) + bytes(4) + b"\xff\xff\x3f" * 2
    return bytes(data[:12]) + extended + bytes(data[12:])


def bmp() -> bytes:
    data = bytearray(cv2.imencode(".bmp", np.zeros((8, 8, 3), np.uint8))[1].tobytes())
    data[18:26] = struct.pack("<ii", SIDE, -SIDE)
    return bytes(data)


def npz(**headers: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, header in headers.items():
            text = header.encode().ljust(117) + b"\n"
            magic = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text))
            archive.writestr(f"{name}.npy", magic + text + bytes(10_000_000))
    return stream.getvalue()


def import_dem(file: Path, **keys: Any) -> None:
    dem.import_dem(DemConfig.model_construct(file=file, **keys))


def sky_labels(file: Path) -> None:
    mapping: Any = {"1": {"label": "sky", "semantic_id": 1}}
    labels = SkyLabelsConfig.model_construct(image=file, mapping=mapping, level=0)
    config = HdriImageConfig.model_construct(file=file, labels_from=(labels,))
    SkyImages().load(config, (0,))


def texture(file: Path) -> None:
    load_texture_folder(file.parent, 1.0)


def label(file: Path) -> None:
    load_label_image(file, {"1": [1]}, [0])


def density(file: Path) -> None:
    density_image(ImageDensity.model_construct(kind="image", file=file, invert=False))


def frame(file: Path) -> None:
    decode_image(file.read_bytes(), "depth", file.name)


BOMBS: dict[str, tuple[str, Callable[[], bytes], Callable[[Path], Any]]] = {
    "dem.tif": ("dem.tif", tiff, import_dem),
    "dem.png": ("dem.png", png, import_dem),
    "dem.exr": ("dem.exr", exr_file, import_dem),
    "sky.hdr": ("sky.hdr", hdr, read_radiance),
    "sky.exr": ("sky.exr", exr_file, read_radiance),
    "sky labels": ("labels.png", png, sky_labels),
    "label image": ("labels.png", png, label),
    "label image, tiff": ("labels.tif", tiff, label),
    "density": ("density.png", png, density),
    "texture.png": ("a_color.png", png, texture),
    "texture.jpg": ("a_color.jpg", jpeg, texture),
    "texture.tif": ("a_color.tif", tiff, texture),
    "texture.exr": ("a_color.exr", exr_file, texture),
    "webp named png": ("a_color.png", webp, texture),
    "bmp named png": ("a_color.png", bmp, texture),
    "a data set's tiff": ("depth_00.tif", tiff, frame),
    "a data set's png": ("depth_00.png", png, frame),
    "a data set's exr": ("depth_00.exr", exr_file, frame),
}


@pytest.mark.parametrize("what", BOMBS)
def test_bombs_are_refused_by_their_header(tmp_path: Path, what: str) -> None:
    name, make, read = BOMBS[what]
    file = tmp_path / name
    file.write_bytes(make())
    assert file.stat().st_size < 10**6
    before = psutil.Process().memory_info().rss
    with pytest.raises(InvalidInputError, match=r"at most \d+ pixels, not 6?\d+ x \d+") as refused:
        read(file)
    assert name in str(refused.value)
    assert psutil.Process().memory_info().rss - before < MUCH_BYTES


@pytest.mark.parametrize("shape", ["(100000, 100000)", "(-1, 7)"])
def test_arrays_are_refused_by_their_header(tmp_path: Path, shape: str) -> None:
    file = tmp_path / "stage.npz"
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}}}"
    file.write_bytes(npz(elevation_m=header))
    with pytest.raises(DocumentError, match=r"40000000000 bytes|has the shape"):
        load_arrays(file, 10**9)
    with pytest.raises(InvalidInputError, match=r"stage\.npz"):
        load_stage(file)


def test_many_small_arrays_are_counted_together(tmp_path: Path) -> None:
    file = tmp_path / "many.npz"
    header = "{'descr': '<f4', 'fortran_order': False, 'shape': (1000000,)}"
    file.write_bytes(npz(**{f"a{number}": header for number in range(5)}))
    assert len(load_arrays(file, 20_000_000)) == 5
    with pytest.raises(DocumentError, match="20000000 bytes, more than 19999999"):
        load_arrays(file, 19_999_999)


def test_pickles_in_arrays_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "objects.npz", a=np.array([{}], object))
    with pytest.raises(ValueError, match="objects"):
        load_arrays(tmp_path / "objects.npz", 10**9)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp", ".webp", ".pgm", ".ppm"])
@pytest.mark.parametrize("channels", [1, 3])
def test_headers_say_what_is_decoded(suffix: str, channels: int) -> None:
    shape = (37, 53) if channels == 1 else (37, 53, channels)
    if (suffix, channels) in ((".pgm", 3), (".ppm", 1)):
        pytest.skip("there is none")
    data = cv2.imencode(suffix, np.zeros(shape, np.uint8))[1].tobytes()
    assert image_size(data) == (53, 37)
    assert decode_pixels(data, TEXTURE, "image").shape[:2] == (37, 53)


@pytest.mark.parametrize(
    "options", [{}, {"progressive": True}, {"exif": b"Exif\0\0" + b"\xff" * 90}]
)
def test_sizes_of_jpegs_of_others(options: dict[str, Any]) -> None:
    stream = io.BytesIO()
    Image.new("RGB", (53, 37)).save(stream, "JPEG", **options)
    assert image_size(stream.getvalue()) == (53, 37)


@pytest.mark.parametrize("big", [False, True])
def test_sizes_of_tiled_and_big_tiffs(big: bool) -> None:
    tiled = {"tiled": True, "blockxsize": 64, "blockysize": 32, "bigtiff": "YES" if big else "NO"}
    assert image_size(tiff(width=53, height=37, **tiled)) == (64, 64)


def test_a_jpeg_with_two_frames_is_refused() -> None:
    data = cv2.imencode(".jpg", np.zeros((8, 8), np.uint8))[1].tobytes()
    place = data.index(b"\xff\xc0")
    length = struct.unpack(">H", data[place + 2 : place + 4])[0] + 2
    twice = data[:place] + data[place : place + length] * 2 + data[place + length :]
    with pytest.raises(ValueError, match="2 frames"):
        image_size(twice)


def jpeg_of_scans(count: int) -> bytes:
    """A progressive JPEG of 4096 x 4096 grey pixels (ITU-T T.81), in which scans change nothing.

    The tables have one code each: a difference of 0, and runs of 16,384 and more empty blocks.
    """

    def segment(marker: int, data: bytes) -> bytes:
        return struct.pack(">BBH", 0xFF, marker, len(data) + 2) + data

    side = 4096
    one_code = bytes([1] + [0] * 15)
    blocks = (side // 8) ** 2
    runs = -(-blocks // (2**15 - 1))
    bits = "0" + "1" * 14
    empty = int((bits * runs).ljust(-(-15 * runs // 8) * 8, "1"), 2)
    run_bytes = empty.to_bytes(-(-15 * runs // 8), "big").replace(b"\xff", b"\xff\0")
    scan = segment(0xDA, bytes([1, 1, 0, 1, 63, 0])) + run_bytes
    return b"".join(
        [
            b"\xff\xd8",
            segment(0xDB, b"\0" + bytes([1] * 64)),
            segment(0xC2, struct.pack(">BHHB", 8, side, side, 1) + bytes([1, 0x11, 0])),
            segment(0xC4, b"\x00" + one_code + b"\0"),
            segment(0xC4, b"\x10" + one_code + b"\xe0"),
            segment(0xDA, bytes([1, 1, 0, 0, 0, 0])) + bytes(blocks // 8),
            scan * (count - 1),
            b"\xff\xd9",
        ]
    )


def test_a_jpeg_of_many_scans_is_refused_before_it_is_decoded() -> None:
    """One of 3,000 scans and 430 KB was decoded for a quarter of a minute."""
    few = jpeg_of_scans(12)
    assert image_size(few) == (4096, 4096)
    assert (decode_pixels(few, TEXTURE, "a.jpg") == 128).all()
    assert image_size(few + b"\xff\xda" * 500) == (4096, 4096), "what follows its end counts not"
    with pytest.raises(ValueError, match="more than 100 scans"):
        image_size(jpeg_of_scans(101))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"GIF89a" + bytes(100),
        b"\x89PNG\r\n\x1a\n",
        b"\xff\xd8\xff",
        b"II*\0",
        b"P5\n",
        b"BM",
        b"RIFF" + bytes(20),
        b"<VRTDataset/>",
    ],
)
def test_other_formats_and_torn_headers_are_refused(tmp_path: Path, data: bytes) -> None:
    file = tmp_path / "a_color.png"
    file.write_bytes(data)
    with pytest.raises(InvalidInputError, match=r"a_color.png.*a texture that can be read"):
        read_pixels(file, TEXTURE)


def test_radiance_files_of_others_are_read_as_before(tmp_path: Path) -> None:
    pixels = np.random.default_rng(3).uniform(0, 9, (8, 16, 3)).astype(np.float32)
    cv2.imwrite(str(tmp_path / "sky.hdr"), pixels)
    data = (tmp_path / "sky.hdr").read_bytes()
    start = radiance_header(data).start
    head = b"#?RGBE\n# by somebody\nEXPOSURE=1\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n"
    (tmp_path / "other.hdr").write_bytes(head + data[start:])
    expected = cv2.imread(str(tmp_path / "sky.hdr"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    for name in ("sky.hdr", "other.hdr"):
        assert (read_radiance(tmp_path / name) == expected).all()


# GeoTIFFs ---------------------------------------------------------------------------------------

VRT = """<VRTDataset rasterXSize="4" rasterYSize="4"><VRTRasterBand dataType="UInt16" band="1">
<SimpleSource><SourceFilename relativeToVRT="0">{source}</SourceFilename></SimpleSource>
</VRTRasterBand></VRTDataset>"""


def heights(path: Path, value: int = 7) -> Path:
    size = {"width": 4, "height": 4, "count": 1, "dtype": "uint16"}
    with rasterio.open(path, "w", driver="GTiff", **size) as file:
        file.write(np.full((4, 4), value, np.uint16), 1)
    return path


@pytest.mark.parametrize("source", ["secret.tif", "/vsicurl/http://127.0.0.1:9/x.tif"])
def test_a_vrt_named_tif_is_refused(tmp_path: Path, source: str) -> None:
    heights(tmp_path / "secret.tif")
    file = tmp_path / "dem.tif"
    file.write_text(VRT.format(source=tmp_path / source if source == "secret.tif" else source))
    for read in (import_dem, lambda path: decode_image(path.read_bytes(), "depth", path.name)):
        with pytest.raises(InvalidInputError, match="that can be read"):
            read(file)


def test_files_beside_a_geotiff_are_not_read(tmp_path: Path) -> None:
    file = heights(tmp_path / "dem.tif")
    (tmp_path / "dem.tfw").write_text("5\n0\n0\n-5\n0\n0\n")
    (tmp_path / "dem.tif.aux.xml").write_text(
        "<PAMDataset><PAMRasterBand band='1'><Scale>100</Scale></PAMRasterBand></PAMDataset>"
    )
    heights(tmp_path / "dem.tif.msk", 0)
    heights(tmp_path / "dem.tif.ovr", 1)
    with open_geotiff(file, ELEVATION) as found:
        assert found.transform.is_identity
        assert found.scales == (1.0,)
        assert (found.read(1, masked=True) == 7).all()
        assert not found.overviews(1)


def test_names_that_mean_something_to_gdal_are_names_of_files(tmp_path: Path) -> None:
    file = heights(tmp_path / "GTIFF_DIR:1:other.tif")
    with open_geotiff(file, ELEVATION) as found:
        assert found.read(1).max() == 7
    with pytest.raises(InvalidInputError, match="No such file"):
        import_dem(Path("/vsicurl/http://127.0.0.1:9/dem.tif"), spacing_m=1.0)


def test_huge_blocks_and_many_bands_of_a_small_geotiff_are_refused() -> None:
    block = {"tiled": True, "blockxsize": 16384, "blockysize": 16384}
    with (
        pytest.raises(InvalidInputError, match="16384 x 16384"),
        open_geotiff(tiff(width=16, height=16, **block), ELEVATION, "dem.tif"),
    ):
        pass
    with (
        pytest.raises(InvalidInputError, match="64 bands, not 5000"),
        open_geotiff(tiff(width=16, height=16, count=5000), ELEVATION, "dem.tif"),
    ):
        pass


def test_deep_and_many_channelled_exr_images_are_refused() -> None:
    stream = io.BytesIO()
    planes = {f"c{number}": np.zeros((4, 4), np.float32) for number in range(9)}
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, planes) as file:
        file.write(stream)
    small = type(FRAME)("a test", 17, "image")
    with pytest.raises(InvalidInputError, match="136 values, not 144"):
        exr.decode_channels(stream.getvalue(), "a.exr", small)


def exr_bytes(*parts: OpenEXR.Part) -> bytes:
    stream = io.BytesIO()
    with OpenEXR.File(list(parts)) as file:
        file.write(stream)
    return stream.getvalue()


def exr_part(name: str, *channels: str) -> OpenEXR.Part:
    planes = {channel: np.full((4, 8), 0.5, np.float32) for channel in channels}
    return OpenEXR.Part({"name": name, "type": OpenEXR.scanlineimage}, planes)


@pytest.mark.parametrize("use", USES, ids=lambda use: use.name)
def test_exr_images_of_several_parts_are_refused_by_their_names(use: ImageUse) -> None:
    """The last one won: depths became the sky's radiance."""
    data = exr_bytes(exr_part("left", *"RGB"), exr_part("depth", *"RGB"))
    with pytest.raises(InvalidInputError, match=r"one part, not of 2: 'left', 'depth'") as refused:
        exr.decode_channels(data, "a.exr", use)
    assert use.field in str(refused.value)
    assert set(exr.decode_channels(data, "a.exr", use, all_parts=True)) == set("RGB")


@pytest.mark.parametrize("layer", ["", "sky."])
def test_exr_images_of_luminance_and_chroma_are_refused(layer: str) -> None:
    """They became a grey sky, and chroma became a texture's colour."""
    names = [layer + name for name in ("Y", "RY", "BY")]
    with pytest.raises(InvalidInputError, match=rf"luminance and {layer}BY, {layer}RY"):
        exr.decode_channels(exr_bytes(exr_part("a", *names)), "a.exr")


def test_exr_images_whose_channels_lack_pixels_are_refused() -> None:
    half = OpenEXR.Channel(np.zeros((2, 4), np.float32), 2, 2)
    data = exr_bytes(OpenEXR.Part({"type": OpenEXR.scanlineimage}, {"Y": half}))
    with pytest.raises(InvalidInputError, match=r"each pixel, not as Y"):
        exr.decode_channels(data, "a.exr")


def windowed(stored: tuple[int, ...], shown: tuple[int, ...], *channels: str) -> bytes:
    """An EXR image of counted values, with its windows: left, top, right, bottom."""
    left, top, right, bottom = stored
    shape = (bottom - top + 1, right - left + 1)
    values = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    windows = {
        name: (np.array(window[:2], np.int32), np.array(window[2:], np.int32))
        for name, window in (("dataWindow", stored), ("displayWindow", shown))
    }
    header = {"type": OpenEXR.scanlineimage, **windows}
    return exr_bytes(OpenEXR.Part(header, dict.fromkeys(channels, values)))


@pytest.mark.parametrize("use", [SKY, TEXTURE, ELEVATION, FRAME], ids=lambda use: use.name)
@pytest.mark.parametrize(
    "stored", [(20, 6, 27, 9), (0, 0, 63, 30), (1, 0, 64, 31), (0, 32, 63, 63), (-64, 0, -1, 31)]
)
def test_exr_images_that_lack_pixels_that_they_show_are_refused(
    use: ImageUse, stored: tuple[int, ...]
) -> None:
    """Eight pixels were the whole sky."""
    data = windowed(stored, (0, 0, 63, 31), *"RGB")
    left, top, right, bottom = stored
    said = rf"\[\[0, 0\], \[63, 31\]\].*\[\[{left}, {top}\], \[{right}, {bottom}\]\]"
    with pytest.raises(InvalidInputError, match=rf"{use.field}.*a\.exr.*{said}"):
        exr.decode_channels(data, "a.exr", use)


def test_exr_images_are_what_they_show(tmp_path: Path) -> None:
    """Overscan was part of the sky."""
    values = np.arange(80 * 44, dtype=np.float32).reshape(44, 80)
    data = windowed((-6, -5, 73, 38), (0, 0, 63, 31), *"RGB")
    (tmp_path / "sky.exr").write_bytes(data)
    (tmp_path / "a_diff.exr").write_bytes(data)
    assert np.array_equal(read_radiance(tmp_path / "sky.exr")[..., 0], values[5:37, 6:70])
    assert np.array_equal(read_map(tmp_path / "a_diff.exr")[0][..., 1], values[5:37, 6:70])
    moved = windowed((100, 200, 163, 231), (100, 200, 163, 231), "Y")
    assert np.array_equal(exr.decode_channels(moved, "a.exr")["Y"], np.arange(2048).reshape(32, 64))


def test_the_bounds_are_documented() -> None:
    text = (Path(__file__).parents[4] / "docs" / "files.md").read_text(encoding="utf-8")
    for use in USES:
        assert f"{use.most_px:,}" in text, use.name


def turned(kind: str, orientation: int) -> bytes:
    """A picture with EXIF of an orientation, as Pillow writes it."""
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    file = io.BytesIO()
    pixels = np.zeros((16, 24, 3), np.uint8)
    pixels[:8, :8] = 255
    lossless = {"WEBP": {"lossless": True}}.get(kind, {})
    Image.fromarray(pixels).save(file, kind, exif=exif, **lossless)
    return file.getvalue()


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_pictures_are_turned_as_exif_says_but_for_a_mesh(kind: str, orientation: int) -> None:
    data = turned(kind, orientation)
    with Image.open(io.BytesIO(data)) as image:
        stored, shown = (np.asarray(each) for each in (image, ImageOps.exif_transpose(image)))
    grey = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE
    for use in USES:
        wanted = stored if use is MESH_TEXTURE else shown
        found = decode_pixels(data, use, "a")[..., ::-1]
        assert np.abs(found.astype(int) - wanted).max() < 20
        one = decode_pixels(data, use, "a", grey)
        assert np.abs(one.astype(int) - wanted.mean(axis=-1)).max() < 20


def test_an_orientation_that_exif_does_not_have_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="EXIF orientation is 9, expected 1 to 8"):
        decode_pixels(turned("PNG", 9), TEXTURE, "a")
