"""Files with several pictures, as Pillow and GDAL write them: the others are told, or refused."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from PIL import Image
from rasterio.enums import Resampling

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_use import ELEVATION, LABEL_IMAGE
from oaisys_core.files.image_formats.images import read_pixels
from oaisys_core.files.image_formats.pictures import MOST, count_pictures
from oaisys_core.files.image_formats.rasters import open_geotiff
from oaisys_core.procedural.textures.map_pixels import read_color

COLOURS = ((200, 30, 30), (30, 200, 30), (30, 30, 200))
ANIMATED: dict[str, dict[str, Any]] = {
    "TIFF": {},
    "WEBP": {"duration": 100, "lossless": True},
    "PNG": {"duration": 100},
}
"""Formats that may have several pictures, with Pillow's options for them."""


def pictures(form: str, count: int) -> bytes:
    first, *others = (Image.new("RGB", (32, 16), COLOURS[k % 3]) for k in range(count))
    file = io.BytesIO()
    first.save(file, form, save_all=count > 1, append_images=others, **ANIMATED[form])
    return file.getvalue()


def grey_pages(count: int) -> bytes:
    first, *others = (Image.new("L", (32, 16), 1 + k) for k in range(count))
    file = io.BytesIO()
    first.save(file, "TIFF", save_all=True, append_images=others)
    return file.getvalue()


@pytest.mark.parametrize("form", ANIMATED)
def test_a_texture_of_several_pictures_is_the_first_one_and_told(
    form: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A page or a frame counted, and nobody said that there were others."""
    for count in (1, 3):
        file = tmp_path / f"{count}.{form}"
        file.write_bytes(pictures(form, count))
        color = read_color(file)
        np.testing.assert_allclose(color[0, 0] * 255, COLOURS[0], atol=1)
        told = f"{file}: it has 3 pictures, of which the first is read"
        assert (told in caplog.text) == (count == 3)


def test_ids_and_heights_are_those_of_one_picture(tmp_path: Path) -> None:
    file = tmp_path / "pages.tif"
    file.write_bytes(grey_pages(2))
    with pytest.raises(InvalidInputError, match=r"pages\.tif.*a label image of one picture, not"):
        read_pixels(file, LABEL_IMAGE)
    with (
        pytest.raises(InvalidInputError, match="an elevation model of one picture, not of 2"),
        open_geotiff(file, ELEVATION),
    ):
        pass
    file.write_bytes(grey_pages(1))
    assert read_pixels(file, LABEL_IMAGE)[0, 0] == 1


@pytest.mark.parametrize("big", ["YES", "NO"])
def test_smaller_copies_and_masks_are_no_pictures_of_their_own(tmp_path: Path, big: str) -> None:
    file = tmp_path / "cog.tif"
    options = {"driver": "GTiff", "width": 64, "height": 64, "count": 1, "dtype": "uint8"}
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        rasterio.open(file, "w", **options, bigtiff=big) as written,
    ):
        written.write(np.full((1, 64, 64), 7, np.uint8))
        written.write_mask(np.eye(64, dtype=np.uint8) * 255)
        written.build_overviews([2, 4], Resampling.nearest)
    assert count_pictures(file.read_bytes()) == 1
    assert read_pixels(file, LABEL_IMAGE).max() == 7


@pytest.mark.parametrize("form", ANIMATED)
def test_what_is_cut_off_or_goes_in_a_circle_is_counted(form: str) -> None:
    whole = pictures(form, 3)
    assert count_pictures(whole) == 3
    for length in range(len(whole)):
        assert 1 <= count_pictures(whole[:length]) <= 3


def test_pages_that_go_in_a_circle_end() -> None:
    circle = bytearray(grey_pages(2))
    first = int.from_bytes(circle[4:8], "little")
    entries = int.from_bytes(circle[first : first + 2], "little")
    link = first + 2 + 12 * entries
    circle[link : link + 4] = first.to_bytes(4, "little")
    assert count_pictures(bytes(circle)) == 1
    assert count_pictures(grey_pages(MOST + 5)) == MOST
