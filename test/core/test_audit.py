"""The audit finds what is wrong, and finds nothing where nothing is."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from oaisys_core.audit import Audited, Reference, audit_sample, audit_views
from oaisys_core.cli import app
from oaisys_core.config import config_from_mapping
from oaisys_core.simulation import Simulation
from oaisys_core.terrain.presets import PRESETS
from oaisys_core.types import Sample

WORLD: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"extent_m": 40.0, "resolution_px": 129},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 128}},
    "sensors": {
        "cameras": [
            {"name": "camera", "width_px": 96, "height_px": 72, "fx_px": 80.0, "fy_px": 75.0}
        ]
    },
}


def audited(config: dict, views: int = 3) -> dict[str, Audited]:
    simulation = Simulation(config_from_mapping(config))
    simulation.step_batch()
    found = audit_views(simulation, views, np.random.default_rng(1))
    simulation.close()
    return {f.modality: f for f in found}


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_every_kind_of_terrain_is_right_off_edges(preset: str) -> None:
    found = audited(WORLD | {"stage": {**WORLD["stage"], "preset": preset}})

    assert found.keys() == {"depth", "semantic_0", "instance"}
    for one in found.values():
        assert one.pixels > 3 * 96 * 72 * 0.5
        assert one.wrong_share <= 5e-4, one


def one_view() -> tuple[Sample, Reference]:
    simulation = Simulation(config_from_mapping(WORLD))
    simulation.step_batch()
    return simulation.step_sample(), Reference(simulation.scene, simulation.ground_truth_mesh())


def shifted(sample: Sample, pixels: int) -> Sample:
    frames = tuple(replace(f, data=np.roll(f.data, pixels, axis=1)) for f in sample.frames)
    return replace(sample, frames=frames)


def test_images_that_are_two_pixels_off_are_found() -> None:
    sample, reference = one_view()

    right = {f.modality: f for f in audit_sample(sample, reference)}
    wrong = {f.modality: f for f in audit_sample(shifted(sample, 2), reference)}

    assert all(f.wrong == 0 for f in right.values())
    assert all(f.wrong_share > 5e-4 for f in wrong.values())


def test_a_depth_that_is_half_a_percent_long_is_found() -> None:
    sample, reference = one_view()
    frames = [replace(f, data=f.data * np.float32(1.005)) for f in sample.frames[1:2]]

    (found,) = audit_sample(replace(sample, frames=tuple(frames)), reference)

    assert found.wrong_share == 1.0
    assert found.worst_m == pytest.approx(0.005 * 10, rel=0.2)


def test_the_command_writes_figures_and_keeps_to_its_limit(tmp_path: Path) -> None:
    config = tmp_path / "world.yaml"
    config.write_text(json.dumps(WORLD))
    arguments = ["audit", "--config", str(config), "--views", "2", "--out"]

    passed = CliRunner().invoke(app, [*arguments, str(tmp_path / "audit.json")])

    assert passed.exit_code == 0, passed.output
    figures = json.loads((tmp_path / "audit.json").read_text())
    assert {f["modality"] for f in figures} == {"depth", "semantic_0", "instance"}
    assert all(f["wrong_share"] <= 5e-4 for f in figures)
