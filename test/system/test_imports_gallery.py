"""The gallery of imported files: ten worlds whose files are made by code."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from PIL import Image

from oaisys_core.config import config_from_mapping
from oaisys_core.files.calibrations.reading import read_robot_file
from tools.gallery.imports.pictures import MOST_BYTES, write_sheet
from tools.gallery.imports.worlds import TILE_PX, make_worlds


@pytest.mark.long
def test_ten_worlds_can_be_rendered(tmp_path: Path) -> None:
    worlds = make_worlds(tmp_path)
    assert len({world.caption for world in worlds}) == 10
    for world in worlds:
        named = tmp_path / world.caption.split(":")[0].split(",")[0].split(" ")[0]
        assert named.exists() or next(tmp_path.rglob(named.name)).exists()
        config_from_mapping(world.sections, tmp_path)
    robot = read_robot_file(next(tmp_path.rglob("scout.urdf")))
    assert robot is not None
    assert len(robot.sensors.cameras) == len(robot.sensors.lidars) == len(robot.sensors.imus) == 1
    with rasterio.open(tmp_path / "valley_utm32.tif") as file:
        assert file.crs.to_epsg() == 32632
        assert 1400 < file.read(1).min() < file.read(1).max() < 3500


def test_a_sheet_stays_small(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (*TILE_PX[::-1], 3), np.uint8)
    path = write_sheet(tmp_path / "sheet.webp", [(f"tile {n}", noise) for n in range(3)])
    assert path.stat().st_size <= MOST_BYTES
    with Image.open(path) as sheet:
        assert sheet.width == 2 * TILE_PX[0] + 8
