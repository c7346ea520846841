"""Heights in files: units, voids, pictures and formats, as their standards and GDAL say."""

from __future__ import annotations

import logging
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
import rasterio.shutil
from PIL import Image
from pydantic import ValidationError
from rasterio.env import GDALVersion
from rasterio.transform import from_origin

from oaisys_core.config.sections.stage import DemConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.output import exr
from oaisys_core.procedural.terrain.dem import ImportedGround, import_dem

UTM = from_origin(500_000, 5_000_000, 10, 10)
FEET = from_origin(1_000_000, 200_000, 10, 10)


def heights(rows: int = 24, cols: int = 30) -> np.ndarray:
    """Relief between 140 and 240, float32, never 0."""
    row, col = np.mgrid[:rows, :cols]
    return np.asarray(190 + 30 * np.sin(row / 5) + 20 * np.cos(col / 4), np.float32)


def write(path: Path, values: np.ndarray, transform: Any = UTM, **more: Any) -> Path:
    planes = values if values.ndim == 3 else values[None]
    unit, driver = more.pop("unit", None), more.pop("driver", "GTiff")
    shape = dict(zip(("count", "height", "width"), planes.shape, strict=True))
    more |= shape | {"dtype": planes.dtype, "transform": transform}
    with rasterio.open(path, "w", driver=driver, **more) as file:
        file.write(planes)
        if unit:
            file.units = (unit,) * len(planes)
    return path


def read(path: Path, **keys: Any) -> ImportedGround:
    return import_dem(DemConfig(file=path, **({"offset_m": 0.0} | keys)))


def stored(ground: ImportedGround) -> np.ndarray:
    """Heights in the order of the file."""
    return ground.ground.elevation_m[::-1].astype(float)


# Units ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", ["1.0", "1.1"])
@pytest.mark.parametrize(
    ("crs", "transform", "pixel_m", "unit_m"),
    [
        ("EPSG:32633+6360", UTM, 10 / 0.9996, 1200 / 3937),
        ("EPSG:32633+5703", UTM, 10 / 0.9996, 1.0),
        ("EPSG:32633+8228", UTM, 10 / 0.9996, 0.3048),
        ("EPSG:2263+5703", FEET, 10 * 1200 / 3937, 1.0),
        ("EPSG:2263+6360", FEET, 10 * 1200 / 3937, 1200 / 3937),
        ("EPSG:32633+5715", UTM, 10 / 0.9996, -1.0),
    ],
)
def test_each_part_of_a_compound_system_has_its_unit(
    tmp_path: Path, crs: str, transform: Any, pixel_m: float, unit_m: float, version: str
) -> None:
    values = heights()
    path = write(tmp_path / "a.tif", values, transform, crs=crs, geotiff_version=version)
    ground = read(path)
    assert ground.ground.spacing_m == pytest.approx(pixel_m, rel=1e-4)
    assert np.allclose(stored(ground), values.astype(float) * unit_m, rtol=1e-6)


def test_feet_of_coordinates_say_nothing_about_heights(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", heights(), FEET, crs="EPSG:2263")
    with pytest.raises(InvalidInputError, match=r"height_unit.*m, ft or us-ft.*US survey foot"):
        read(path)
    assert np.allclose(stored(read(path, height_unit="ft")), heights() * 0.3048, rtol=1e-6)
    assert np.allclose(stored(read(path, height_unit="m")), heights(), rtol=1e-6)


@pytest.mark.parametrize("dtype", ["int16", "uint16", "uint8"])
def test_integers_without_a_place_have_the_unit_of_their_band(tmp_path: Path, dtype: str) -> None:
    counts = np.rint(heights()).astype(dtype)
    path = write(tmp_path / "feet.tif", counts, transform=None, unit="ft")
    assert np.allclose(stored(read(path, spacing_m=1.0)), counts * 0.3048)
    assert np.allclose(stored(read(path, spacing_m=1.0, height_unit="m")), counts)
    with pytest.raises(InvalidInputError, match="has heights"):
        read(path, size_m=(1, 1, 1))


@pytest.mark.parametrize("unit", ["m", "ft", "us-ft", None])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_images_have_the_unit_that_is_stated(tmp_path: Path, unit: Any, suffix: str) -> None:
    counts = np.rint(heights() * 100).astype(np.uint16)
    cv2.imwrite(str(path := tmp_path / f"image{suffix}"), counts)
    unit_m = {"ft": 0.3048, "us-ft": 1200 / 3937}.get(unit, 1.0)
    found = stored(read(path, spacing_m=1.0, scale=0.01, height_unit=unit))
    assert np.allclose(found, counts * 0.01 * unit_m, rtol=1e-6)


@pytest.mark.parametrize("key", [{"scale": 0.001}, {"height_unit": "ft"}])
def test_size_m_goes_without_another_unit_of_heights(tmp_path: Path, key: Any) -> None:
    cv2.imwrite(str(path := tmp_path / "image.png"), heights().astype(np.uint16))
    with pytest.raises(ValidationError, match=f"expected {next(iter(key))} or size_m"):
        DemConfig(file=path, size_m=(1, 1, 1), **key)
    plain = DemConfig(file=path, size_m=(1, 1, 1))
    assert DemConfig.model_validate(plain.model_dump()) == plain


def test_a_unit_that_contradicts_the_reference_system_is_asked_for(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", heights(), UTM, crs="EPSG:32633+5703", unit="foot")
    with pytest.raises(InvalidInputError, match=r"height_unit.*foot.*metre"):
        read(path)
    assert np.allclose(stored(read(path, height_unit="ft")), heights() * 0.3048, rtol=1e-6)


# Voids ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("void", [-32768, -32767, -9999, -3.4028234663852886e38, 3.4e38])
@pytest.mark.parametrize("suffix", ["tif", "exr"])
def test_voids_without_a_tag_are_no_pits(tmp_path: Path, void: float, suffix: str) -> None:
    values = heights()
    values[5:9, 7:12] = void
    path = tmp_path / f"a.{suffix}"
    if suffix == "tif":
        write(path, values, crs="EPSG:32633")
    else:
        exr.write_channels(path, {exr.GREY: values})
    keys: dict[str, Any] = {} if suffix == "tif" else {"spacing_m": 10.0}
    if abs(void) < 1e30:
        with pytest.raises(InvalidInputError, match=rf"20 pixels of {void:g}.*nodata: {void:g}"):
            read(path, **keys)
        keys["nodata"] = void
    found = read(path, **keys)
    assert (found.holes, found.filled_px) == (1, 20)
    known = values > 0
    known &= values < 1e30
    assert stored(found).min() > 130
    assert np.allclose(stored(found)[known], values[known])


def test_integers_and_several_kinds_of_voids(tmp_path: Path) -> None:
    values = heights().astype(np.int16)
    values[3, 3], values[8:10, 4], values[20, 20:23] = -32768, -9999, 0
    path = write(tmp_path / "a.tif", values, crs="EPSG:32633", nodata=-9999)
    with pytest.raises(InvalidInputError, match="-32768"):
        read(path)
    assert read(path, nodata=(-32768, 0)).filled_px == 1 + 2 + 3
    assert stored(read(path, nodata="none")).min() == -32768


@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint16", "float32", "float64"])
@pytest.mark.parametrize("nodata", [None, 7])
def test_heights_under_an_alpha_of_0_are_voids(
    tmp_path: Path, dtype: str, nodata: int | None
) -> None:
    """GDAL heeds no alpha of floats, nor any beside a value for voids: heights of 0 were left."""
    values = heights().astype(dtype)
    planes = np.stack([values, np.full_like(values, 1)])
    planes[:, 4:9, 5:9] = 0
    planes[0, 20, 20] = 7
    path = write(
        tmp_path / "a.tif", planes, crs="EPSG:32633", alpha="YES", photometric="MINISBLACK"
    )
    with rasterio.open(path, "r+") as file:
        file.nodata = nodata
    found = read(path, nodata=7)
    assert (found.holes, found.filled_px) == (2, 5 * 4 + 1)
    assert found.ground.elevation_m.min() > 130
    # Of a window the alpha is that of the window.
    window = {"window": {"size_m": [100, 100]}}
    assert read(path, nodata=7, **window).filled_px < 21


def test_transparent_pixels_of_an_exr_are_voids(tmp_path: Path) -> None:
    values, alpha = heights(), np.ones((24, 30), np.float32)
    values[5, 5:7] = alpha[5, 5:7] = 0
    for names in (("Y", "A"), ("R", "G", "B", "A"), ("height", "A")):
        exr.write_channels(tmp_path / "a.exr", dict.fromkeys(names, values) | {"A": alpha})
        assert read(tmp_path / "a.exr", spacing_m=1.0).filled_px == 2
    exr.write_channels(tmp_path / "a.exr", dict.fromkeys("XYZ", values))
    with pytest.raises(InvalidInputError, match="in Y or Z, not in both"):
        read(tmp_path / "a.exr", spacing_m=1.0)


def test_a_value_for_voids_counts_beside_a_mask(tmp_path: Path) -> None:
    values = heights()
    values[3, 3] = values[10, 10] = -9999.1
    mask = np.full(values.shape, 255, np.uint8)
    mask[15:17, 15] = 0
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        path = write(tmp_path / "a.tif", values, crs="EPSG:32633", nodata=-9999.1)
        with rasterio.open(path, "r+") as file:
            file.write_mask(mask)
    assert read(path).filled_px == 4


@pytest.mark.parametrize(
    ("scale", "offset"), [(0.0, 0.0), (np.nan, 0.0), (np.inf, 0.0), (1.0, np.nan), (1.0, -np.inf)]
)
def test_a_scale_that_leaves_no_relief_is_refused(
    tmp_path: Path, scale: float, offset: float
) -> None:
    path = write(tmp_path / "a.tif", heights(), crs="EPSG:32633")
    with rasterio.open(path, "r+") as file:
        file.scales, file.offsets = (scale,), (offset,)
    refused = rf"scale of {scale:g} and an offset of {offset:g} in band 1.*other than 0"
    with pytest.raises(InvalidInputError, match=refused):
        read(path)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_tiff_that_is_to_be_turned_is_refused(tmp_path: Path, orientation: int) -> None:
    path = tmp_path / "a.tif"
    Image.fromarray(heights().astype(np.uint16)).save(path, tiffinfo={274: orientation})
    if orientation == 1:
        assert np.allclose(stored(read(path, spacing_m=1.0)), heights().astype(int))
        return
    with pytest.raises(InvalidInputError, match=f"orientation {orientation}.*expected 1"):
        read(path, spacing_m=1.0)


@pytest.mark.parametrize("what", ["cliff", "island", "trench", "tower", "flat"])
def test_rough_relief_is_no_void(tmp_path: Path, what: str) -> None:
    values = heights(40, 40)
    if what == "cliff":
        values[:, 20:] += 900
    elif what == "island":  # a mountain in a flat sea
        row, col = np.mgrid[:40, :40]
        values = np.maximum(0, 4000 - 600 * np.hypot(row - 20, col - 20)).astype(np.float32)
    elif what == "trench":  # of a sea of integers, of which one is -9999
        values = np.linspace(-2000, -10_100, 1600).reshape(40, 40).round().astype(np.float32)
        values[10, 10] = -9999
    elif what == "tower":
        values[20, 20] += 400
    else:
        values[:] = 7
    path = write(tmp_path / "a.tif", values, crs="EPSG:32633")
    assert np.allclose(stored(read(path)), values)


def test_the_median_is_that_of_measured_ground(tmp_path: Path) -> None:
    values = np.full((21, 21), 100, np.float32)
    values[:, 12:] = 200
    values[:, 13:] = np.nan  # filled with 200
    path = write(tmp_path / "a.tif", values, crs="EPSG:32633")
    assert stored(read(path, offset_m=None))[0, 0] == 0


# Pictures ---------------------------------------------------------------------------------------


def test_pictures_are_no_elevation_models(tmp_path: Path) -> None:
    random = np.random.default_rng(1).integers(0, 255, (3, 24, 30), dtype=np.uint8)
    rgb = write(tmp_path / "rgb.tif", random, crs="EPSG:32633", photometric="RGB")
    for file, keys in ((rgb, {}), (tmp_path / "rgb.png", {"spacing_m": 1.0})):
        if file.suffix == ".png":
            cv2.imwrite(str(file), np.moveaxis(random[::-1], 0, -1))
        with pytest.raises(InvalidInputError, match=r"dem\.band.*colours of a picture"):
            read(file, **keys)
        assert np.allclose(stored(read(file, band=2, nodata="none", **keys)), random[1])
    palette = tmp_path / "palette.tif"
    with rasterio.open(
        palette, "w", driver="GTiff", width=30, height=24, count=1, dtype="uint8", transform=UTM
    ) as file:
        file.write(random[0], 1)
        file.write_colormap(1, {n: (n, 255 - n, 0, 255) for n in range(256)})
    with pytest.raises(InvalidInputError, match="palette"):
        read(palette)
    colors = dict(zip("RGB", random.astype(np.float32), strict=True))
    exr.write_channels(tmp_path / "rgb.exr", colors)
    with pytest.raises(InvalidInputError, match="equal R, G and B"):
        read(tmp_path / "rgb.exr", spacing_m=1.0)


@pytest.mark.parametrize("kind", ["grey", "rgb", "rgba", "jpg", "16 bits"])
def test_heightmaps_of_gazebo(tmp_path: Path, kind: str, caplog: pytest.LogCaptureFixture) -> None:
    """SDF: the image spans <size>, its largest value is as high as size z, 0 is at <pos>."""
    row, col = np.mgrid[:129, :129]
    image = np.uint8(200 * np.exp(-((row - 30) ** 2 + (col - 90) ** 2) / 800)) + np.uint8(0)
    path = tmp_path / ("map.jpg" if kind == "jpg" else "map.png")
    written = {
        "grey": image,
        "jpg": cv2.cvtColor(image, cv2.COLOR_GRAY2BGR),
        "rgb": cv2.cvtColor(image, cv2.COLOR_GRAY2BGR),
        "rgba": np.dstack([image, image, image, np.full_like(image, 255)]),
        "16 bits": image.astype(np.uint16) * 257,
    }[kind]
    cv2.imwrite(str(path), written)
    with caplog.at_level(logging.WARNING):
        ground = read(path, size_m=(128, 256, 40), position_m=(10, 20, -5), offset_m=None).ground
    assert ("256 steps" in caplog.text) == (kind != "16 bits")
    assert ground.extent_m == pytest.approx((-54, -108, 74, 148))
    assert ground.elevation_m.max() == pytest.approx(35, abs=0.5)
    assert ground.elevation_m.min() == pytest.approx(-5, abs=0.5)
    top = np.unravel_index(ground.elevation_m.argmax(), ground.elevation_m.shape)
    x, y = -54 + top[1] * ground.spacing_m, -108 + top[0] * ground.spacing_m
    # Column 90 of 129 is 26 of 128 m right of the middle, row 30 is 34 pixels of 2 m above it.
    assert (x, y) == pytest.approx((10 + 26, 20 + 68), abs=4 if kind == "jpg" else 1)
    with pytest.raises(InvalidInputError, match="size_m"):
        read(write(tmp_path / "a.tif", heights(), crs="EPSG:32633"), size_m=(1, 1, 1))


# Formats ----------------------------------------------------------------------------------------

FORMATS = {
    "AAIGrid": "asc",
    "HFA": "img",
    "netCDF": "nc",
    "GSAG": "grd",
    "GSBG": "grd",
    "GS7BG": "grd",
    "BT": "bt",
    "SIGDEM": "sigdem",
    "HF2": "hf2",
    "ISIS3": "cub",
    "XYZ": "xyz",
    "ZMap": "dat",
    "NITF": "ntf",
    "GTX": "gtx",
    "ELAS": "elas",
    "GRIB": "grb2",
}


if GDALVersion.runtime().at_least("3.12"):  # which writes neither
    del FORMATS["GS7BG"], FORMATS["ELAS"]


@pytest.mark.parametrize("driver", FORMATS)
def test_formats_that_are_one_file(tmp_path: Path, driver: str) -> None:
    source = write(tmp_path / "source.tif", heights(), crs="EPSG:32633")
    path = tmp_path / f"a.{FORMATS[driver]}"
    rasterio.shutil.copy(source, path, driver=driver)
    # The former is always in degrees, the latter has no false easting.
    keys = {"crs": "EPSG:32633"} if driver in ("GTX", "ISIS3") else {}
    found = read(path, **keys)
    assert found.ground.spacing_m == pytest.approx(10, rel=5e-4)
    assert np.allclose(stored(found), heights(), atol=0.02)


def test_a_terrain_of_terragen_begins_in_the_south(tmp_path: Path) -> None:
    """Terragen's format: rows from the south on; an altitude is base + value * scale / 65536."""
    stored_rows = np.array([[2, 2, 2], [1, 1, 1], [0, 0, 0]], "<i2") * 4096
    chunks = [b"SIZE", struct.pack("<hh", 2, 0), b"XPTS", struct.pack("<hh", 3, 0)]
    chunks += [b"YPTS", struct.pack("<hh", 3, 0), b"SCAL", struct.pack("<3f", 30, 30, 30)]
    chunks += [b"ALTW", struct.pack("<hh", 16, 0), stored_rows.tobytes(), b"EOF "]
    path = tmp_path / "a.ter"
    path.write_bytes(b"TERRAGENTERRAIN " + b"".join(chunks))
    south_first_m = read(path).ground.elevation_m
    assert np.ptp(south_first_m, axis=1).max() < 1e-3
    steps_m = (
        south_first_m[0, 0] - south_first_m[-1, 0],
        south_first_m[0, 0] - south_first_m[1, 0],
    )
    assert steps_m == pytest.approx((60, 30), abs=0.01)


@pytest.mark.parametrize("name", ["N46E009.hgt", "s05w070.HGT"])
def test_a_tile_of_srtm_knows_its_place_by_its_name(tmp_path: Path, name: str) -> None:
    values = np.full((1201, 1201), 500, ">i2")
    values[600, 600] = 900
    values[3, 3] = -32768  # what the format says of a void
    path = tmp_path / name
    path.write_bytes(values.tobytes())
    found = read(path, ground_spacing_m=100.0)
    _, y0, _, y1 = found.ground.extent_m
    assert found.filled_px == 1
    # A degree along the meridian on WGS 84, by PROJ: 111,148 m at 46.5° N and 110,580 m at 4.5° S.
    assert y1 - y0 == pytest.approx(111_148 if name[0] == "N" else 110_580, abs=400)
    (tmp_path / "tile.hgt").write_bytes(values.tobytes())
    with pytest.raises(InvalidInputError):
        read(tmp_path / "tile.hgt")


def test_degrees_without_a_reference_system_are_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "a.asc"
    head = "ncols 3\nnrows 3\nxllcorner 9.5\nyllcorner 46\ncellsize 0.0002777\nNODATA_value -9999\n"
    path.write_text(head + "1 2 3\n4 5 6\n7 8 -9999\n")
    with pytest.raises(InvalidInputError, match=r"dem\.crs.*look like degrees.*EPSG:4326"):
        read(path)
    found = read(path, crs="EPSG:4326")
    assert found.filled_px == 1
    assert found.ground.spacing_m == pytest.approx(0.0002777 * 77_470, rel=2e-3)
    assert read(path, spacing_m=2.0).ground.spacing_m == 2


def pds(pointer: str, more: str = "") -> bytes:
    label = (
        "PDS_VERSION_ID = PDS3\r\nRECORD_TYPE = FIXED_LENGTH\r\nRECORD_BYTES = 512\r\n"
        f'^IMAGE = {pointer}\r\n{more}^DATA_SET_MAP_PROJECTION = "DSMAP.CAT"\r\n'
        "OBJECT = IMAGE\r\nLINES = 24\r\nLINE_SAMPLES = 30\r\nSAMPLE_TYPE = PC_REAL\r\n"
        "SAMPLE_BITS = 32\r\nEND_OBJECT = IMAGE\r\nEND\r\n"
    )
    return label.encode().ljust(1024) + heights().astype("<f4").tobytes()


def test_a_label_may_not_name_another_file(tmp_path: Path) -> None:
    secret = tmp_path / "secret.dat"
    secret.write_bytes(heights().tobytes())
    path = tmp_path / "a.img"
    path.write_bytes(pds("3"))
    assert np.allclose(stored(read(path, spacing_m=1.0)), heights())
    for pointer in (f'"{secret}"', f'("{secret}", 1)', '"../secret.dat"', '\r\n  "secret.dat"'):
        path.write_bytes(pds(pointer))
        with pytest.raises(InvalidInputError, match="not in another file"):
            read(path, spacing_m=1.0)
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(2000))
    with pytest.raises(InvalidInputError, match=r"HDF5.*gdal_translate"):
        read(path)
    path.write_bytes(bytes(512) + b"\x89HDF\r\n\x1a\n" + bytes(2000))
    with pytest.raises(InvalidInputError, match="HDF5"):
        read(path)


def test_a_huge_grid_in_a_small_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.asc"
    path.write_text("ncols 900000\nnrows 900000\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3\n")
    # GDAL 3.12 refuses it itself.
    with pytest.raises(InvalidInputError, match=r"100000000 pixels|900000 x 900000"):
        read(path)
