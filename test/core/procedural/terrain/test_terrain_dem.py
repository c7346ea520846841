"""Relief from files, against planes in closed form."""

from __future__ import annotations

import logging
import tracemalloc
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
import scipy
from rasterio.transform import Affine, from_origin

from oaisys_core.config.sections.stage import DemConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.output import exr
from oaisys_core.procedural.terrain import dem
from oaisys_core.procedural.terrain.dem import write_dem
from oaisys_core.procedural.terrain.holes import fill_holes
from oaisys_core.scene import HeightField

EAST, NORTH = 0.3, -0.2
"""Rise of the plane per metre."""


def import_dem(path: Path, **keys: Any) -> dem.ImportedGround:
    return dem.import_dem(DemConfig.model_construct(file=path, **keys))


def plane(rows: int, cols: int, pixel_m: tuple[float, float]) -> np.ndarray:
    """Heights of pixel centres, row 0 in the north, 100 m at the image's centre."""
    x = (np.arange(cols) - (cols - 1) / 2) * pixel_m[0]
    y = ((rows - 1) / 2 - np.arange(rows)) * pixel_m[1]
    return 100 + EAST * x[None, :] + NORTH * y[:, None]


def write_tiff(path: Path, values: np.ndarray, transform: Affine | None, **more: Any) -> Path:
    scale, offset = more.pop("scale", 1.0), more.pop("offset", 0.0)
    unit = more.pop("unit", None)
    rows, cols = values.shape
    shape = {"width": cols, "height": rows, "count": 1, "dtype": values.dtype}
    with rasterio.open(path, "w", driver="GTiff", transform=transform, **shape, **more) as file:
        file.write(values, 1)
        file.scales, file.offsets = (scale,), (offset,)
        if unit:
            file.units = (unit,)
    return path


def assert_is_plane(ground: HeightField, atol: float) -> None:
    x, y, z = ground.vertices_m().astype(float).T
    assert np.allclose(z, 100 + EAST * x + NORTH * y, atol=atol)


def test_a_geotiff_has_its_own_scale(tmp_path: Path) -> None:
    path = write_tiff(
        tmp_path / "plane.tif",
        plane(31, 41, (2.5, 2.5)).astype(np.float32),
        from_origin(500_000, 5_000_000, 2.5, 2.5),
        crs='LOCAL_CS["site",UNIT["metre",1]]',
    )
    imported = import_dem(path, offset_m=0.0)
    assert imported.ground.extent_m == pytest.approx((-50, -37.5, 50, 37.5))
    assert imported.ground.spacing_m == 2.5
    assert imported.holes == imported.filled_px == 0
    assert_is_plane(imported.ground, 1e-4)


def test_pixels_that_are_no_squares_become_squares(tmp_path: Path) -> None:
    path = write_tiff(
        tmp_path / "plane.tif",
        plane(21, 41, (2.0, 5.0)).astype(np.float32),
        from_origin(0, 0, 2.0, 5.0),
    )
    ground = import_dem(path, offset_m=0.0).ground
    assert ground.elevation_m.shape == (51, 41)
    assert_is_plane(ground, 1e-4)


def test_heights_have_scale_offset_and_unit(tmp_path: Path) -> None:
    counts = np.rint((plane(9, 9, (1, 1)) / 0.3048 - 200) / 0.01).astype(np.int16)
    path = write_tiff(
        tmp_path / "feet.tif", counts, from_origin(0, 0, 1, 1), scale=0.01, offset=200.0, unit="ft"
    )
    assert_is_plane(import_dem(path, offset_m=0.0).ground, 0.01)


@pytest.mark.parametrize("flip_x", [False, True])
def test_images_from_south_to_north_and_east_to_west(tmp_path: Path, flip_x: bool) -> None:
    step_x, x0 = (-1.0, 9.0) if flip_x else (1.0, 3.0)
    values = plane(9, 9, (1, 1))[::-1, :: -1 if flip_x else 1].astype(np.float32)
    path = write_tiff(tmp_path / "up.tif", values, Affine(step_x, 0, x0, 0, 1, 0))
    assert_is_plane(import_dem(path, offset_m=0.0).ground, 1e-4)


def test_degrees_become_metres_of_the_ellipsoid(tmp_path: Path) -> None:
    values = np.zeros((11, 11), np.float32)
    path = write_tiff(
        tmp_path / "degrees.tif", values, from_origin(10, 45.00055, 1e-4, 1e-4), crs="EPSG:4326"
    )
    x0, y0, x1, y1 = import_dem(path, ground_spacing_m=0.1).ground.extent_m
    # Length of a degree at 45 degrees north on WGS 84, from tables.
    assert y1 - y0 == pytest.approx(111_131.7 * 1e-3, abs=0.15)
    assert x1 - x0 == pytest.approx(78_846.8 * 1e-3, abs=0.15)


def test_holes_are_filled_and_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    values = plane(40, 50, (1, 1)).astype(np.float32)
    values[5:12, 6:20] = -9999
    values[25:33, 30:34] = np.nan
    path = write_tiff(tmp_path / "holes.tif", values, from_origin(0, 0, 1, 1), nodata=-9999)
    with caplog.at_level(logging.WARNING):
        imported = import_dem(path, offset_m=0.0)
    assert (imported.holes, imported.filled_px) == (2, 7 * 14 + 8 * 4)
    assert "filled 2 holes, 130 pixels" in caplog.text
    assert_is_plane(imported.ground, 1e-3)


def test_a_hole_is_as_smooth_as_can_be() -> None:
    y, x = np.mgrid[-20:21, -20:21].astype(float)
    harmonic = x**2 - y**2
    missing = np.hypot(x, y) < 12
    result = fill_holes(np.where(missing, np.nan, harmonic), missing)
    assert np.allclose(result, harmonic, atol=1e-6), "x² - y² solves the discrete equation as well"


def test_a_very_large_hole_is_as_smooth() -> None:
    y, x = np.mgrid[-150:151, -150:151].astype(float)
    plane = 0.3 * x - 0.2 * y
    missing = np.hypot(x, y) < 120
    result = fill_holes(np.where(missing, np.nan, plane), missing)
    assert np.abs(result - plane).max() < 0.5, "a percent of the relief across the hole"
    assert (result[~missing] == plane[~missing]).all()
    steps = np.hypot(*np.gradient(result))
    assert np.abs(steps - np.hypot(0.3, 0.2)).max() < 0.15, "no steps, not even at the rim"


def test_a_wide_hole_costs_little_memory() -> None:
    """Equations as a matrix took 380 bytes a pixel: gigabytes for four points 3 km apart."""
    side_px = 1200
    missing = np.ones((side_px, side_px), np.bool_)
    missing[::300, ::300] = False
    height_m = np.where(missing, np.nan, np.random.default_rng(1).random(missing.shape))
    tracemalloc.start()
    try:
        filled_m = fill_holes(height_m, missing)
        _, most_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most_bytes < 90 * missing.size
    known = height_m[~missing]
    assert filled_m.min() >= known.min() - 1e-3
    assert filled_m.max() <= known.max() + 1e-3


def test_a_wide_hole_is_filled_as_a_narrow_one(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    ground = scipy.ndimage.gaussian_filter(rng.normal(size=(400, 400)), 20) * 100
    missing = np.hypot(*(np.mgrid[:400, :400] - 200)) < 150
    wide = fill_holes(np.where(missing, np.nan, ground), missing)
    monkeypatch.setattr("oaisys_core.procedural.terrain.holes.WIDE_SHARE", 2.0)
    narrow = fill_holes(np.where(missing, np.nan, ground), missing)
    assert np.ptp(ground) > 5
    assert np.abs(wide - narrow).max() < 1e-3


def test_an_image_that_was_never_measured_at_its_edge_goes_on() -> None:
    missing = np.zeros((30, 30), np.bool_)
    missing[:, :10] = True
    result = fill_holes(np.where(missing, np.nan, 7.0), missing)
    assert np.allclose(result, 7.0)


def test_a_png_needs_a_scale(tmp_path: Path) -> None:
    heights = plane(17, 33, (1.5, 1.5))
    path = tmp_path / "plane.png"
    cv2.imwrite(str(path), np.rint((heights - 50) / 0.002).astype(np.uint16))
    ground = import_dem(path, spacing_m=1.5, scale=0.002, offset_m=50.0).ground
    assert_is_plane(ground, 1.1e-3)
    with pytest.raises(InvalidInputError, match=r"spacing_m"):
        import_dem(path)


def test_an_exr_keeps_its_floats(tmp_path: Path) -> None:
    heights = plane(17, 33, (0.5, 0.5)).astype(np.float32)
    heights[3, 4] = np.nan
    exr.write_channels(tmp_path / "plane.exr", {exr.GREY: heights})
    imported = import_dem(tmp_path / "plane.exr", spacing_m=0.5, offset_m=0.0)
    assert imported.filled_px == 1
    assert_is_plane(imported.ground, 1e-4)


def test_a_coarser_ground_has_the_same_plane(tmp_path: Path) -> None:
    heights = plane(101, 101, (0.5, 0.5)).astype(np.float32)
    exr.write_channels(tmp_path / "plane.exr", {exr.GREY: heights})
    ground = import_dem(
        tmp_path / "plane.exr", spacing_m=0.5, ground_spacing_m=2.0, offset_m=0.0
    ).ground
    assert ground.elevation_m.shape == (26, 26)
    inner = HeightField(ground.elevation_m[2:-2, 2:-2], (-21.0, -21.0), 2.0)
    assert_is_plane(inner, 1e-3)


def test_the_median_comes_to_zero(tmp_path: Path) -> None:
    exr.write_channels(tmp_path / "plane.exr", {exr.GREY: plane(9, 9, (1, 1)).astype(np.float32)})
    ground = import_dem(tmp_path / "plane.exr", spacing_m=1.0).ground
    assert np.median(ground.elevation_m) == 0


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    elevation_m = np.random.default_rng(1).normal(size=(13, 17)).astype(np.float32)
    ground = HeightField(elevation_m, (-4.0, -3.0), 0.5)
    write_dem(tmp_path / "ground.tif", ground)
    again = import_dem(tmp_path / "ground.tif", offset_m=0.0).ground
    assert again.elevation_m.tobytes() == elevation_m.tobytes()
    assert again.extent_m == pytest.approx(ground.extent_m)


def test_files_that_are_no_relief_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.tif").write_text("no image")
    for name in ("text.tif", "missing.tif", "image.jpg", "missing.png"):
        with pytest.raises(InvalidInputError, match=name.partition(".")[0]):
            import_dem(tmp_path / name, spacing_m=1.0)
    values = np.zeros((5, 5), np.float32)
    turned = write_tiff(tmp_path / "turned.tif", values, Affine(1, 0.5, 0, 0.5, -1, 0))
    with pytest.raises(InvalidInputError, match="rows from west to east"):
        import_dem(turned)
    plain = write_tiff(tmp_path / "plain.tif", values, from_origin(0, 0, 1, 1))
    with pytest.raises(InvalidInputError, match="band"):
        import_dem(plain, band=2)
    with pytest.raises(InvalidInputError, match="ground_spacing_m"):
        import_dem(plain, ground_spacing_m=1e-5)
    empty = write_tiff(
        tmp_path / "empty.tif", np.full((5, 5), np.nan, np.float32), from_origin(0, 0, 1, 1)
    )
    with pytest.raises(InvalidInputError, match="heights in it"):
        import_dem(empty)
