"""`oaisys heights --address`, whose world is the one that stands there."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import oaisys_here


@pytest.mark.parametrize(
    "option",
    [("--config", "world.yaml"), ("--seed", "3"), ("--backend", "analytic"), ("--batch", "2")],
)
def test_options_of_a_world_beside_an_address_are_refused(
    option: tuple[str, str], tmp_path: Path
) -> None:
    """They were ignored: the heights were those of another world than the one asked for."""
    out = tmp_path / "heights.npz"
    refused = oaisys_here("heights", "--out", out, "--address", "127.0.0.1:1", *option)
    assert refused.returncode == 2, refused.stderr
    assert f"--address: received '127.0.0.1:1', expected none with {option[0]}" in refused.stderr
