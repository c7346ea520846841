"""Choices of materials that both renderers share: how large the texels of a picture are."""

from dataclasses import replace

import pytest
from synthetic_worlds import CENTRED

from oaisys_core.render.shading.looks import MANY_SAMPLES, pixel_angle_rad, texel_px


@pytest.mark.parametrize("fx_px", [90.0, 541.14, 2000.0])
@pytest.mark.parametrize("samples", [1, 3, MANY_SAMPLES, 256])
def test_the_largest_texel_is_as_large_as_a_picture_allows(fx_px: float, samples: int) -> None:
    camera = replace(CENTRED, fx_px=fx_px, fy_px=0.9 * fx_px)
    allowed_rad = texel_px(samples) / fx_px
    found_rad = pixel_angle_rad(camera, texel_px(samples))
    assert 0.8 * allowed_rad < found_rad <= allowed_rad * (1 + 1e-9)


def test_pictures_of_many_samples_lack_no_detail_up_to_nyquist() -> None:
    assert texel_px(1) == texel_px(MANY_SAMPLES - 1) <= 1
    assert texel_px(MANY_SAMPLES) == texel_px(512) <= 0.5
