"""Sizes so small that one can compute neither with their squares nor with their inverse."""

from __future__ import annotations

from typing import Any

import pytest

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import ConfigError

LAYER = {"label": "gravel", "semantic_id": 1}


@pytest.mark.parametrize("size_m", [5e-324, 1e-308, 0.9e-4])
@pytest.mark.parametrize(
    ("section", "field"),
    [
        (lambda size: {"materials": {"mask": {"scale_m": size}}}, r"materials\.mask\.scale_m"),
        (
            lambda size: {"materials": {"variation": {"scale_m": size}}},
            r"materials\.variation\.scale_m",
        ),
        (
            lambda size: {"assets": {"rocks": [{"size_m": [size, size]}]}},
            r"assets\.rocks\.0\.size_m",
        ),
    ],
)
def test_sizes_whose_inverse_overflows_are_refused(section: Any, field: str, size_m: float) -> None:
    """A shift by a negative count, and rotations of length 0, ended commands with a traceback."""
    with pytest.raises(ConfigError, match=f"{field}: "):
        config_from_mapping(section(size_m))
    config_from_mapping(section(1e-4))


@pytest.mark.parametrize(
    ("section", "field"),
    [
        (
            lambda tile: {"materials": {"layers": [LAYER | {"tile_m": tile}]}},
            r"materials\.layers\.0\.tile_m",
        ),
        (lambda tile: {"assets": {"rock_tile_m": tile}}, r"assets\.rock_tile_m"),
    ],
)
def test_tiles_far_below_a_millimetre_are_refused(section: Any, field: str) -> None:
    """The land at the horizon was black, where it is a billion such tiles away."""
    with pytest.raises(ConfigError, match=rf"{field}: received 1e-06, expected .*0\.01"):
        config_from_mapping(section(1e-6))
    config_from_mapping(section(0.01))
