"""Height grids against closed forms, against queries at points, and read by rasterio itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import yaml
from commands import oaisys_here

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import CancelledError, InvalidInputError
from oaisys_core.output.heights import read_heights, write_heights
from oaisys_core.simulation import Simulation
from oaisys_core.types import HeightGrid, Progress
from oaisys_core.world.height_grids import MAX_CELLS

SPHERE = {"shape": "sphere", "radius_m": 2.0, "position_m": [3.0, -1.0, 1.0]}


def world(stage: dict[str, Any] | None = None, **assets: Any) -> dict[str, Any]:
    plain = {"preset": "plane", "extent_m": 20.0, "resolution_px": 65}
    return {
        "backend": "analytic",
        "stage": plain | (stage or {}),
        "materials": {"texture_size_px": 32, "mask": {"size_px": 32, "relief": 0}},
        "assets": {"rocks": [], **assets},
    }


def simulation(config: dict[str, Any]) -> Simulation:
    sim = Simulation(config_from_mapping(config))
    sim.step_batch()
    return sim


def centres(grid: HeightGrid) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = grid.ground_m.shape
    x0, y0 = grid.origin_xy_m
    x_m, y_m = np.meshgrid(
        x0 + grid.spacing_m * np.arange(columns), y0 + grid.spacing_m * np.arange(rows)
    )
    return x_m, y_m


def test_a_sphere_on_a_plane_is_as_the_closed_form_says() -> None:
    grid = simulation(world(primitives=[SPHERE])).height_grid(0.25)
    assert grid.ground_m.shape == (80, 80)
    assert grid.ground_m.dtype == grid.surface_m.dtype == np.float32
    assert grid.origin_xy_m == pytest.approx((-9.875, -9.875))
    x, y = centres(grid)
    beside_m2 = (x - 3) ** 2 + (y + 1) ** 2
    expected_m = np.where(beside_m2 < 4, 1 + np.sqrt(np.maximum(4 - beside_m2, 0)), 0.0)
    np.testing.assert_array_equal(grid.ground_m, 0)
    np.testing.assert_allclose(grid.surface_m, expected_m, atol=2e-3)
    assert (grid.surface_m > 2.9).sum() > 0


def test_a_mound_given_as_a_dem_is_as_its_formula_says(tmp_path: Path) -> None:
    at = np.linspace(-10, 10, 401)
    mound_m = 3 * np.exp(-(at[None, :] ** 2 + 2 * at[:, None] ** 2) / 20)
    dem = tmp_path / "mound.tif"
    pixel_m = at[1] - at[0]
    to_map = rasterio.Affine(pixel_m, 0, 0, 0, -pixel_m, 0)
    shape = {"height": 401, "width": 401, "count": 1, "dtype": "float32", "transform": to_map}
    with rasterio.open(dem, "w", driver="GTiff", **shape) as file:
        file.write(mound_m[::-1].astype(np.float32), 1)
    config = world()
    config["stage"] = {"dem": {"file": str(dem)}, "resolution_px": 401}
    grid = simulation(config).height_grid(0.1)
    x, y = centres(grid)
    formula_m = 3 * np.exp(-(x**2 + 2 * y**2) / 20)
    # A DEM's datum may be moved: heights are compared but for that.
    assert np.nanstd(grid.ground_m - formula_m) < 2e-3


def test_a_grid_is_what_queries_at_its_centres_say_and_nan_off_the_stage() -> None:
    sim = simulation(world({"preset": "mounds"}, primitives=[SPHERE]))
    grid = sim.height_grid(0.5, (-12.2, -3.0, 5.1, 11.0))
    assert grid.ground_m.shape == (28, 35)
    x, y = centres(grid)
    points = np.column_stack((x.ravel(), y.ravel(), np.zeros(x.size)))
    asked = sim.query_height(points, on_stage=True)
    for found, expected in (
        (grid.ground_m, asked.ground_height_m),
        (grid.surface_m, asked.surface_height_m),
    ):
        np.testing.assert_array_equal(found.ravel(), expected.astype(np.float32))
    outside = (np.abs(x) > 10) | (np.abs(y) > 10)
    np.testing.assert_array_equal(np.isnan(grid.ground_m), outside)
    np.testing.assert_array_equal(np.isnan(grid.surface_m), outside)
    assert outside.any()


def test_rasterio_reads_frame_units_and_places(tmp_path: Path) -> None:
    sim = simulation(world({"preset": "mounds"}, primitives=[SPHERE]))
    grid = sim.height_grid(0.5, (-11.0, -4.0, 5.0, 6.0))
    write_heights(tmp_path / "heights.tif", grid)
    with rasterio.open(tmp_path / "heights.tif") as file:
        assert file.descriptions == ("ground", "surface")
        assert file.units == ("m", "m")
        assert np.isnan(file.nodata)
        assert file.tags().get("AREA_OR_POINT", "Area") == "Area"  # GDAL's default
        told = {"FRAME": "map", "UNITS": "metres", "HEIGHTS_AT": "centres of pixels"}
        assert told.items() <= file.tags().items()
        assert file.bounds == pytest.approx((-11, -4, 5, 6))
        assert file.res == (0.5, 0.5)
        points = [(3.25, -1.25), (-9.75, 5.75), (-10.75, 0.25)]
        assert file.xy(*file.index(*points[0])) == pytest.approx(points[0])
        sampled = np.array(list(file.sample(points)))
    asked = sim.query_height([(x, y, 0.0) for x, y in points], on_stage=True)
    np.testing.assert_array_equal(sampled[:, 0], asked.ground_height_m.astype(np.float32))
    np.testing.assert_array_equal(sampled[:, 1], asked.surface_height_m.astype(np.float32))
    assert np.isnan(sampled[2]).all()


@pytest.mark.parametrize("name", ["heights.tif", "heights.npz"])
def test_files_come_back_as_they_were(tmp_path: Path, name: str) -> None:
    grid = simulation(world({"preset": "mounds"})).height_grid(0.3, (-10.5, -2.0, 4.0, 3.0))
    write_heights(tmp_path / name, grid)
    found = read_heights(tmp_path / name)
    np.testing.assert_array_equal(found.ground_m, grid.ground_m)
    np.testing.assert_array_equal(found.surface_m, grid.surface_m)
    assert found.origin_xy_m == pytest.approx(grid.origin_xy_m)
    assert found.spacing_m == pytest.approx(grid.spacing_m)


@pytest.mark.parametrize(
    "resolution_m", [0.0, -1.0, float("nan"), float("inf"), 1e-3, 5e-324, 1e308]
)
def test_a_resolution_that_makes_no_grid_is_refused(resolution_m: float) -> None:
    with pytest.raises(InvalidInputError, match="resolution_m"):
        simulation(world()).height_grid(resolution_m)


@pytest.mark.parametrize(
    "extent_m",
    [(0, 0, 0, 1), (1, 0, 0, 1), (0, 0, float("inf"), 1), (0, float("nan"), 1, 1)],
)
def test_an_extent_that_is_none_is_refused(extent_m: Any) -> None:
    with pytest.raises(InvalidInputError, match="extent_m"):
        simulation(world()).height_grid(0.5, extent_m)
    with pytest.raises(InvalidInputError, match=str(MAX_CELLS)):
        simulation(world()).height_grid(0.5, (-1e7, -1e7, 1e7, 1e7))
    with pytest.raises(InvalidInputError, match=r"extent_m: .*-1e\+07 to 1e\+07"):
        simulation(world()).height_grid(0.5, (-1e300, -1e300, 1e300, 1e300))


def test_a_cell_s_centre_lies_in_the_extent() -> None:
    """A wider cell has its centre beyond the extent's other edge, where nothing is asked for."""
    sim = simulation(world())
    assert sim.height_grid(2.0, (0, 0, 1, 3)).ground_m.shape == (2, 1)
    with pytest.raises(InvalidInputError, match=r"received 2\.1, expected at most 2 m"):
        sim.height_grid(2.1, (0, 0, 1, 3))


def test_a_grid_can_be_cancelled() -> None:
    def cancel(_: Progress) -> None:
        raise CancelledError("enough")

    with pytest.raises(CancelledError):
        simulation(world()).height_grid(0.05, progress=cancel)


@pytest.mark.long
def test_the_command_writes_a_file_or_says_why_not(tmp_path: Path) -> None:
    config = tmp_path / "world.yaml"
    config.write_text(yaml.safe_dump(world({"preset": "mounds"})))
    out = tmp_path / "heights.tif"
    done = oaisys_here(
        "heights", "--config", config, "--resolution", 0.5, "--out", out, "--extent", "-4,-4,4,6"
    )
    assert done.returncode == 0, done.stderr
    assert "16 x 20 cells of 0.5 m" in done.stdout
    expected = simulation(world({"preset": "mounds"})).height_grid(0.5, (-4, -4, 4, 6))
    np.testing.assert_array_equal(read_heights(out).ground_m, expected.ground_m)
    for arguments in (
        ("--out", tmp_path / "heights.png"),
        ("--out", out, "--resolution", 0),
        ("--out", out, "--extent", "1,2,3"),
    ):
        refused = oaisys_here("heights", "--config", config, *arguments)
        assert refused.returncode == 2
        assert "Traceback" not in refused.stderr
