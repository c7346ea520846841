"""Choices of materials that both renderers share: how large the texels of a picture are."""

from dataclasses import replace

import pytest
from synthetic_worlds import CENTRED

from oaisys_core.render.shading.looks import TEXEL_PX, pixel_angle_rad


@pytest.mark.parametrize("fx_px", [90.0, 541.14, 2000.0])
def test_the_largest_texel_is_as_large_as_a_picture_allows(fx_px: float) -> None:
    camera = replace(CENTRED, fx_px=fx_px, fy_px=0.9 * fx_px)
    allowed_rad = TEXEL_PX / fx_px
    found_rad = pixel_angle_rad(camera, TEXEL_PX)
    assert 0.8 * allowed_rad < found_rad <= allowed_rad * (1 + 1e-9)
