"""The audit finds what is wrong, and finds nothing where nothing is."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import pytest
from commands import oaisys_here
from typer.testing import CliRunner

from oaisys_core.cli.main import app
from oaisys_core.config import config_from_mapping
from oaisys_core.procedural.terrain.presets import PRESETS
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, Pose, Sample
from oaisys_core.verification.audit import (
    WINDOW_PX,
    WINDOWS,
    AuditResult,
    audit_sample,
    audit_views,
)
from oaisys_core.verification.numpy_caster import NumpyCaster
from oaisys_core.verification.reference_scene import ReferenceScene

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

ON_PLAIN: dict[str, Any] = {**WORLD, "stage": {**WORLD["stage"], "surroundings": "plain"}}

FEW_ROCKS = {"rocks": [{"kind": "angular", "count": [60, 60], "variants": 4}]}

SAMPLED_PX = WINDOWS * (WINDOW_PX - 2) ** 2
"""Of each image, edges included."""


def audited(config: dict, views: int) -> dict[str, AuditResult]:
    simulation = Simulation(config_from_mapping({"assets": FEW_ROCKS, **config}))
    simulation.step_batch()
    found = audit_views(simulation, views, np.random.default_rng(1))
    simulation.close()
    return {f.modality: f for f in found}


SEEN = {"mountain_2"}
"""Presets of test-full: with broken rock and what lies on its ledges."""


@pytest.mark.parametrize(
    "preset",
    [
        pytest.param(preset, marks=pytest.mark.long if preset in SEEN else pytest.mark.soak)
        for preset in sorted(PRESETS)
    ],
)
def test_every_kind_of_terrain_is_right_off_edges(preset: str) -> None:
    stage = {"preset": preset, "extent_m": 40.0, "resolution_px": 65}
    found = audited({**WORLD, "stage": stage}, views=1)

    assert found.keys() == {"depth", "semantic_0", "instance"}
    for one in found.values():
        assert one.pixels > SAMPLED_PX * 0.4
        assert one.wrong_share <= 5e-4, one


@pytest.fixture(scope="module")
def one_view() -> tuple[Sample, ReferenceScene]:
    rocks = {"rocks": [{"kind": "angular", "count": 400, "variants": 4}]}
    config = config_from_mapping({**ON_PLAIN, "assets": rocks})
    simulation = Simulation(config)
    simulation.step_batch()
    return simulation.step_sample(), ReferenceScene(
        simulation.scene, simulation.ground_truth_mesh()
    )


def drawn() -> np.random.Generator:
    return np.random.default_rng(2)


def shifted(sample: Sample, pixels: int) -> Sample:
    frames = tuple(replace(f, data=np.roll(f.data, pixels, axis=1)) for f in sample.frames)
    return replace(sample, frames=frames)


def test_images_that_are_two_pixels_off_are_found(one_view: tuple[Sample, ReferenceScene]) -> None:
    sample, reference = one_view
    right = {f.modality: f for f in audit_sample(sample, reference, drawn())}
    wrong = {f.modality: f for f in audit_sample(shifted(sample, 2), reference, drawn())}

    assert all(f.wrong == 0 for f in right.values())
    assert all(f.wrong_share > 5e-4 for f in wrong.values())


def test_a_depth_that_is_half_a_percent_long_is_found(
    one_view: tuple[Sample, ReferenceScene],
) -> None:
    sample, reference = one_view
    frames = [replace(f, data=f.data * np.float32(1.005)) for f in sample.frames[1:2]]

    (found,) = audit_sample(replace(sample, frames=tuple(frames)), reference, drawn())

    assert found.wrong_share == 1.0
    assert found.worst_m == pytest.approx(0.005 * 10, rel=0.2)


@pytest.mark.long
def test_an_error_of_embree_itself_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Distances of all rays that Open3D casts, by whom ever, are 1 % long."""
    casting = o3d.t.geometry.RaycastingScene
    cast = casting.cast_rays

    def cast_too_far(scene: Any, rays: Any) -> Any:
        found = cast(scene, rays)
        found["t_hit"] = found["t_hit"] * 1.01
        return found

    monkeypatch.setattr(casting, "cast_rays", cast_too_far)
    found = audited(WORLD | {"stage": {**WORLD["stage"], "preset": "dunes"}}, views=1)

    assert found["depth"].wrong_share > 0.9


@pytest.mark.long
def test_level_views_are_right_up_to_the_horizon() -> None:
    simulation = Simulation(config_from_mapping({**WORLD, "assets": FEW_ROCKS}))
    simulation.step_batch()
    reference = ReferenceScene(simulation.scene, simulation.ground_truth_mesh())
    z_m = float(simulation.query_height([(3.0, 4.0, 0.0)]).surface_height_m[0]) + 2.0
    for yaw_rad in (0.3, 2.0, 4.5):
        pose = Pose((3.0, 4.0, z_m), (0.0, 0.0, np.sin(yaw_rad / 2), np.cos(yaw_rad / 2)))
        sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))
        for found in audit_sample(sample, reference, drawn()):
            assert found.pixels > 0.4 * SAMPLED_PX
            assert found.wrong == 0, found


def test_rays_meet_the_triangles_that_solving_for_each_finds() -> None:
    rng = np.random.default_rng(5)
    corners = rng.uniform((-3, -3, -1), (3, 3, 9), (50, 1, 3)) + rng.normal(size=(50, 3, 3))
    rays = np.append(rng.uniform(-1, 1, (20, 20, 2)), np.ones((20, 20, 1)), axis=-1)
    caster = NumpyCaster(corners.reshape(-1, 3), np.arange(150).reshape(-1, 3))
    depth_m, found = caster.nearest(rays)
    expected = np.full((20, 20, 50), np.inf)
    for place in np.ndindex(20, 20):
        for index, (a, b, c) in enumerate(corners):
            u, v, t = np.linalg.solve(np.column_stack((b - a, c - a, -rays[place])), -a)
            if t > 0 and u > 0 and v > 0 and u + v < 1:
                expected[(*place, index)] = t
    hit = np.isfinite(expected).any(axis=-1)
    assert 0.3 < hit.mean() < 1
    assert (np.isfinite(depth_m) == hit).all()
    assert (found[hit] == expected[hit].argmin(axis=-1)).all()
    np.testing.assert_allclose(depth_m[hit], expected[hit].min(axis=-1), rtol=1e-9)


def test_the_command_writes_figures_and_keeps_to_its_limit(tmp_path: Path) -> None:
    config = tmp_path / "world.yaml"
    config.write_text(json.dumps({**ON_PLAIN, "assets": FEW_ROCKS}))
    arguments = ["audit", "--config", str(config), "--views", "2", "--out"]

    passed = CliRunner().invoke(app, [*arguments, str(tmp_path / "audit.json")])

    assert passed.exit_code == 0, passed.output
    figures = json.loads((tmp_path / "audit.json").read_text())
    assert {f["modality"] for f in figures} == {"depth", "semantic_0", "instance"}
    assert all(f["wrong_share"] <= 5e-4 for f in figures)


@pytest.mark.parametrize(
    ("camera", "render", "options", "expected"),
    [
        ({}, {}, ["--size", "1x1"], "camera: width_px, height_px: received (1, 1), expected at"),
        ({}, {}, ["--size", "96x2"], "received (96, 2), expected at least 3 x 3 pixels"),
        ({}, {}, ["--size", "3x3"], "has pixels off edges to compare"),
        ({}, {"passes": ["rgb"]}, [], "there are no depth or labels to audit"),
        ({"step_offset": 5}, {}, [], "views: received 1, expected so many that a camera is due"),
        ({"modalities": ["rgb", "normal"]}, {}, [], "no depth or labels to audit"),
    ],
)
def test_an_audit_that_compares_nothing_is_refused(
    tmp_path: Path, camera: dict, render: dict, options: list[str], expected: str
) -> None:
    """Of images of one pixel, all of which are edges, 0 of 0 pixels were wrong: it passed."""
    (given,) = WORLD["sensors"]["cameras"]
    config = tmp_path / "world.yaml"
    sensors = {"cameras": [{**given, **camera}]}
    config.write_text(
        json.dumps({**ON_PLAIN, "assets": {"rocks": []}, "sensors": sensors, "render": render})
    )
    refused = oaisys_here("audit", "--config", config, "--views", "1", *options)
    assert refused.returncode == 2, refused.stdout
    assert expected in " ".join(refused.stderr.split())
