"""Elevation models that are texts: each word is a height, a void, or refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from oaisys_core.config.sections.stage import DemConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_use import ELEVATION
from oaisys_core.files.image_formats.rasters import open_raster
from oaisys_core.procedural.terrain.dem import ImportedGround, import_dem


def read(path: Path, **keys: Any) -> ImportedGround:
    return import_dem(DemConfig(file=path, offset_m=0.0, **keys))


def stored(ground: ImportedGround) -> np.ndarray:
    """Heights in the order of the file."""
    return ground.ground.elevation_m[::-1].astype(float)


ROWS = "1 2 3\n4 5 6\n7 8 9\n"
GRASS = "north: 30\nsouth: 0\neast: 30\nwest: 0\nrows: 3\ncols: 3\n"
ISG = """begin_of_head ================================================
model name     : x
model type     : gravimetric
units          : meters
reference      : GRS80
lat min        =   39.5
lat max        =   42.5
lon min        =  119.5
lon max        =  122.5
delta lat      =    1.0
delta lon      =    1.0
nrows          =      3
ncols          =      3
nodata         =  -9999.0
ISG format     =    1.0
end_of_head ==================================================
"""
GXF = "#POINTS\n3\n#ROWS\n3\n#PTSEPARATION\n10\n#RWSEPARATION\n10\n#SENSE\n1\n#GRID\n"
TEXTS = {
    "asc": "ncols 3\nnrows 3\nxllcorner 1000\nyllcorner 2000\ncellsize 10\n",
    "grass": GRASS,
    "grd": "DSAA\n3 3\n1000 1020\n2000 2020\n1 9\n",
    "isg": ISG,
    "gxf": GXF,
}


def text_grid(path: Path, kind: str, rows: str, head: str = "") -> Path:
    file = path / f"a.{kind}"
    file.write_text(TEXTS[kind] + head + rows, encoding="latin-1")
    return file


@pytest.mark.parametrize("kind", TEXTS)
def test_heights_in_a_text_are_as_they_stand_there(tmp_path: Path, kind: str) -> None:
    expected = np.arange(1.0, 10).reshape(3, 3)
    odd = ["1 2 3 4\r\n5\r\n6 +7. 80e-1 9.0\r\n\x1a", ROWS.replace("9", "9,0")]
    for rows in [ROWS, *(odd if kind != "gxf" else [])]:
        found = stored(read(text_grid(tmp_path, kind, rows), spacing_m=10.0))
        assert (found == (expected[::-1] if kind in ("grd", "gxf") else expected)).all()


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize(
    "word", ["abc", "null", "1e", "0x10", "1_0", "1.2.3", "1-2", "--1", "1.5D2", "\xbd", "n/a"]
)
def test_a_word_among_heights_is_refused(tmp_path: Path, kind: str, word: str) -> None:
    """GDAL took it for 0, or for the number that it begins with."""
    path = text_grid(tmp_path, kind, ROWS.replace("5", word))
    with pytest.raises(InvalidInputError, match=r"the height .*expected a number"):
        read(path, spacing_m=10.0)


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize(
    ("rows", "count"),
    [
        (ROWS + "1 2 3\n", 12),
        (ROWS + "10", 10),
        (ROWS.replace(" 6", ""), 8),
        (ROWS[:12], 6),
    ],
)
def test_more_or_fewer_heights_than_announced_are_refused(
    tmp_path: Path, kind: str, rows: str, count: int
) -> None:
    """One that lacked moved all others by a pixel, and surplus rows were left out."""
    path = text_grid(tmp_path, kind, rows)
    with pytest.raises(InvalidInputError, match=rf"{count} heights.*expected 9 \(3 columns x 3"):
        read(path, spacing_m=10.0)


@pytest.mark.parametrize(
    ("kind", "head", "void"),
    [
        ("asc", "NODATA_value -9999\n", "-9999"),
        ("asc", "nodata_value -9999.1\n", "-9999.1"),
        ("asc", "NODATA_value *\n", "*"),
        ("asc", "NODATA_value none\n", "none"),
        ("asc", "NODATA_value nan\n", "nan"),
        ("asc", "", "1.#QNAN"),
        ("asc", "", "-1.#IND"),
        ("grass", "", "*"),
        ("grass", "null: 77\n", "77"),
        ("grass", "null: nothing\ntype: float\nmultiplier: 1.0\n", "nothing"),
        ("isg", "", "-9999.0000"),
        ("grd", "", "1.70141e+38"),
    ],
)
def test_voids_in_a_text_are_what_its_header_says(
    tmp_path: Path, kind: str, head: str, void: str
) -> None:
    """A height of 0 was a void where the header names a word, and GRASS's ``*`` was 0."""
    rows = ROWS.replace("5", void).replace("1 2", "0 2")
    found = read(text_grid(tmp_path, kind, rows, head), spacing_m=10.0)
    assert found.filled_px == 1
    assert found.ground.elevation_m.min() == 0
    assert 4 < found.ground.elevation_m[1, 1] < 6


def test_a_word_among_heights_of_a_width_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.dat"
    size = {"width": 3, "height": 3, "count": 1, "dtype": "float64"}
    with rasterio.open(path, "w", driver="ZMap", transform=from_origin(0, 30, 10, 10), **size) as f:
        f.write(np.arange(1000.0, 1009).reshape(1, 3, 3))
    assert stored(read(path)).max() == 1008
    path.write_text(path.read_text().replace("1004.", "10o4."))
    with pytest.raises(InvalidInputError, match=r"the height .*10o4\..*a number"):
        read(path)


def test_heights_of_grass_with_a_multiplier_are_refused(tmp_path: Path) -> None:
    path = text_grid(tmp_path, "grass", ROWS, "multiplier: 0.1\n")
    with pytest.raises(InvalidInputError, match=r"a multiplier of '0\.1'"):
        read(path)


@pytest.mark.parametrize("least", [0, 1, -40_000, 0.5, -40_000.5])
@pytest.mark.parametrize("missing", range(9))
def test_a_point_that_is_missing_has_no_height(tmp_path: Path, least: float, missing: int) -> None:
    """Where no value is left for voids, GDAL gives it a height of 0."""
    points = [f"{n % 3} {n // 3} {least + n % 3 + 100 * (n // 3)}\n" for n in range(9)]
    path = tmp_path / "a.xyz"
    path.write_text("x y z\n" + "".join(points))
    assert read(path, nodata="none").holes == 0
    path.write_text("".join(points[:missing] + points[missing + 1 :]))
    with open_raster(path, ELEVATION) as file:
        has_void = file.nodata is not None
    if has_void:
        assert read(path).filled_px == 1
    else:
        with pytest.raises(InvalidInputError, match=r"8 points.*expected 9 \(3 columns x 3 rows"):
            read(path)
    points[missing] = f"{missing % 3} {missing // 3} -9999\n"
    path.write_text("".join(points))
    assert read(path, nodata=-9999).filled_px == 1
