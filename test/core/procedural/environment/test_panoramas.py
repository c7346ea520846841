"""Panoramas of the sky: radiance as it is in the file, photographs by IEC 61966-2-1."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from oaisys_core.config.sections.environment import HdriImageConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.output.exr import write_channels
from oaisys_core.procedural.environment.hdri import SkyImages, read_radiance

HEIGHT = 8


def panorama(dtype: type[np.generic], *rgb: float) -> np.ndarray:
    image = np.empty((HEIGHT, 2 * HEIGHT, 3), dtype)
    image[:] = rgb[::-1]
    return image


@pytest.mark.parametrize(
    ("name", "dtype", "most"),
    [("sky.png", np.uint8, 255), ("sky.png", np.uint16, 65535), ("sky.jpg", np.uint8, 255)],
)
def test_a_photograph_is_decoded_from_srgb_and_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, name: str, dtype: type, most: int
) -> None:
    shade = round(0.5 * most)
    file = tmp_path / name
    cv2.imwrite(str(file), panorama(dtype, shade, shade, shade))
    radiance = read_radiance(file)
    assert radiance.shape == (HEIGHT, 2 * HEIGHT, 3)
    np.testing.assert_allclose(radiance, ((0.5 + 0.055) / 1.055) ** 2.4, rtol=0.02)
    assert "a photograph in sRGB" in caplog.text


def test_red_stays_red(tmp_path: Path) -> None:
    file = tmp_path / "sky.png"
    cv2.imwrite(str(file), panorama(np.uint8, 255, 0, 0))
    np.testing.assert_array_equal(read_radiance(file)[0, 0], (1.0, 0.0, 0.0))


def test_radiance_is_read_as_it_is(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = tmp_path / "sky.hdr"
    cv2.imwrite(str(file), panorama(np.float32, 20.0, 2.0, 0.5))
    np.testing.assert_allclose(read_radiance(file)[0, 0], (20.0, 2.0, 0.5), rtol=0.01)
    assert not caplog.text


def radiance_file(path: Path, *header: str, form: str = "32-bit_rle_rgbe") -> Path:
    """A file whose pixels are 1, 0.5 and 0.25."""
    lines = "".join(f"{line}\n" for line in ("#?RADIANCE", *header, f"FORMAT={form}"))
    size = f"\n-Y {HEIGHT} +X {2 * HEIGHT}\n"
    pixels = bytes([128, 64, 32, 129]) * (2 * HEIGHT * HEIGHT)
    path.write_bytes(lines.encode() + size.encode() + pixels)
    return path


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ([], (1, 0.5, 0.25)),
        (["EXPOSURE=4.0"], (0.25, 0.125, 0.0625)),
        (["EXPOSURE= 4.0", "# taken twice", "EXPOSURE=5e-1"], (0.5, 0.25, 0.125)),
        (["COLORCORR=2 1 0.5"], (0.5, 0.5, 0.5)),
        (["COLORCORR= 2 1 0.5", "EXPOSURE=0.1", "COLORCORR=1 0.5 1"], (5, 10, 5)),
        (["pfilt -x 16", "\tEXPOSURE=4", "# EXPOSURE=3", "GAMMA=1"], (1, 0.5, 0.25)),
    ],
)
def test_radiance_is_without_the_exposure_of_its_file(
    tmp_path: Path, header: list[str], expected: tuple[float, ...]
) -> None:
    """By Radiance's standard; indented lines are the history of files that it was made of."""
    file = radiance_file(tmp_path / "sky.hdr", *header)
    np.testing.assert_allclose(read_radiance(file)[0, 0], expected, rtol=1e-6)


@pytest.mark.parametrize(
    "line",
    [
        *("EXPOSURE=", "EXPOSURE=0", "EXPOSURE=-2", "EXPOSURE=nan", "EXPOSURE=much"),
        *("EXPOSURE=1 2", "COLORCORR=1", "COLORCORR=1 0 1", "COLORCORR=1 2 3 4"),
    ],
)
def test_an_exposure_that_is_none_is_refused(tmp_path: Path, line: str) -> None:
    file = radiance_file(tmp_path / "sky.hdr", line)
    with pytest.raises(InvalidInputError, match=rf"sky\.hdr.*its header says '{line}'"):
        read_radiance(file)


def test_other_pixels_of_radiance_files_are_refused(tmp_path: Path) -> None:
    for header in ([], ["FORMAT=32-bit_rle_rgbe"]):
        file = radiance_file(tmp_path / "sky.hdr", *header, form="32-bit_rle_xyze")
        with pytest.raises(InvalidInputError, match="pixels are '32-bit_rle_xyze'"):
            read_radiance(file)


@pytest.mark.parametrize("names", ["RG", "XYZ", "YZ", "A", "RYA"])
def test_channels_that_are_no_colours_are_no_sky(tmp_path: Path, names: str) -> None:
    plane = np.ones((HEIGHT, 2 * HEIGHT), np.float32)
    write_channels(tmp_path / "sky.exr", dict.fromkeys(names, plane))
    with pytest.raises(InvalidInputError, match=r"R, G and B, or Y, not A?,? ?[A-Z]"):
        read_radiance(tmp_path / "sky.exr")


def test_other_files_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "sky.gif"
    file.write_bytes(b"GIF89a")
    with pytest.raises(InvalidInputError, match=r"\.exr, \.hdr, \.png"):
        read_radiance(file)


def test_an_image_is_read_again_once_its_file_has_changed(tmp_path: Path) -> None:
    """A server went on with the old sky in all later worlds, without a word."""
    file, images = tmp_path / "sky.hdr", SkyImages()
    cv2.imwrite(str(file), panorama(np.float32, 0.25, 0.25, 0.25))
    config = HdriImageConfig(file=file)
    first = images.load(config, (1,))
    assert images.load(config, (1,)) is first
    cv2.imwrite(str(file), panorama(np.float32, 0.75, 0.75, 0.75))
    second = images.load(config, (1,))
    assert second is not first
    np.testing.assert_allclose(second.radiance, 0.75, rtol=0.01)
    file.unlink()
    with pytest.raises(InvalidInputError, match=r"sky\.hdr.*still there"):
        images.load(config, (1,))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_invalid_pixels_are_told_and_many_refused(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, value: float
) -> None:
    """A sky of nothing else was black, without a word."""
    image = np.ones((16, 32), np.float32)
    for bad in (5, 6, image.size):
        image.ravel()[:bad] = value
        write_channels(tmp_path / "sky.exr", dict.fromkeys("RGB", image))
        if bad == 5:
            read_radiance(tmp_path / "sky.exr")
            assert "5 pixels are not finite" in caplog.text
            continue
        with pytest.raises(InvalidInputError, match=r"at most 1 % of the pixels"):
            read_radiance(tmp_path / "sky.exr")
