"""`oaisys render --world-seed`: the world that a sample or the live page names by its seed."""

from __future__ import annotations

import json
from pathlib import Path

from commands import oaisys_here

WORLD = """
backend: analytic
stage: {surroundings: plain, preset: mounds, extent_m: 20, resolution_px: 33}
materials: {texture_size_px: 32, mask: {size_px: 32}}
assets: {rocks: [{count: [3, 3]}]}
sensors: {cameras: [{width_px: 16, height_px: 12, modalities: [depth]}]}
"""


def test_the_world_has_the_seed_that_is_given(tmp_path: Path) -> None:
    world, out = tmp_path / "world.yaml", tmp_path / "out"
    world.write_text(WORLD, encoding="utf-8")
    options = ["render", "--config", str(world), "--out", str(out), "--world-seed", "2000007"]
    refused = oaisys_here(*options, "--batches", "2")
    assert refused.returncode == 2
    assert "world-seed: received 2000007, expected none with several worlds" in refused.stderr
    rendered = oaisys_here(*options)
    assert rendered.returncode == 0, rendered.stderr
    (record,) = (out / "batch_0001" / "meta_data" / "sample_data").glob("*.json")
    assert json.loads(record.read_text(encoding="utf-8"))["provenance"]["batch_seed"] == 2000007
