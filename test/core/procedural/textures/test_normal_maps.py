"""Normals as bytes, and back."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.textures.normal_maps import decode_normals, encode_normals


def test_bytes_come_back_and_components_to_half_a_step() -> None:
    codes = np.arange(1, 256, dtype=np.uint8)
    np.testing.assert_array_equal(encode_normals(decode_normals(codes)), codes)
    components = np.linspace(-1, 1, 1001, dtype=np.float32)
    back = decode_normals(encode_normals(components))
    np.testing.assert_allclose(back, components, atol=0.5 / 127 + 1e-6)


def test_a_flat_surface_and_its_opposites_are_exact() -> None:
    exact = np.array([-1, 0, 1], np.float32)
    np.testing.assert_array_equal(decode_normals(encode_normals(exact)), exact)
