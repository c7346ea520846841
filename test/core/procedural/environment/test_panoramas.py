"""Panoramas of the sky: radiance as it is in the file, photographs by IEC 61966-2-1."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from oaisys_core.config.sections.environment import HdriImageConfig
from oaisys_core.errors import InvalidInputError
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
