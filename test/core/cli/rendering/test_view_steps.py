"""`oaisys render --position X Y Z --look-at X Y Z`."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import yaml
from commands import oaisys_here

from oaisys_core.cli.rendering.pose_steps import ViewSteps
from oaisys_core.config import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import pose_to_matrix
from oaisys_core.simulation import Simulation

Point = tuple[float, float, float]
WORLD = """
backend: analytic
stage: {preset: plane, extent_m: 20, resolution_px: 33, surroundings: plain}
materials: {texture_size_px: 32, mask: {size_px: 32}}
assets: {rocks: [{count: [3, 3]}]}
sensors: {cameras: [{width_px: 16, height_px: 12, modalities: [depth]}]}
"""


@pytest.mark.parametrize("target_m", [(3.0, 4.0, 0.0), (1.0, 2.0, 0.0), (-5.0, 2.0, 9.0)])
def test_the_rig_s_x_axis_points_at_the_target(target_m: Point) -> None:
    position_m = (1.0, 2.0, 6.0)
    with closing(Simulation(config_from_mapping(yaml.safe_load(WORLD)))) as simulation:
        (request,) = ViewSteps(position_m, target_m, 1).requests(simulation)
    sensor = request.metadata.sensor
    assert sensor is not None
    T_map_rig = pose_to_matrix(sensor["pose"])
    towards = np.subtract(target_m, position_m)
    np.testing.assert_allclose(T_map_rig[:3, 0], towards / np.linalg.norm(towards), atol=1e-9)
    np.testing.assert_allclose(T_map_rig[:3, 3], position_m)


@pytest.mark.parametrize(
    ("position_m", "target_m", "message"),
    [
        (None, (0.0, 0.0, 0.0), r"position: received None"),
        ((0.0, 0.0, 1.0), None, r"look-at: received None"),
        ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0), r"another point than --position"),
        ((1e200, 0.0, 5.0), (0.0, 0.0, 0.0), r"position: received \[1e\+200"),
        ((1.0, 0.0, 5.0), (1e308, 1e308, 5.0), r"look-at: received \[1e\+308"),
    ],
)
def test_half_a_view_is_refused(
    position_m: Point | None, target_m: Point | None, message: str
) -> None:
    with pytest.raises(InvalidInputError, match=message):
        ViewSteps(position_m, target_m, 1)


def test_a_refused_view_leaves_nothing_that_hinders_the_next_try(tmp_path: Path) -> None:
    world, out = tmp_path / "world.yaml", tmp_path / "out"
    world.write_text(WORLD, encoding="utf-8")
    options = ["render", "--config", str(world), "--out", str(out), "--look-at", "4", "0", "0"]
    refused = oaisys_here(*options, "--position", "-4", "0", "-9")
    assert refused.returncode == 2
    assert "from z = 0.050 m on the rig is high enough" in refused.stderr
    assert not out.exists()
    rendered = oaisys_here(*options, "--position", "-4", "0", "9")
    assert rendered.returncode == 0, rendered.stderr
    # What a run has rendered is not withdrawn by one that is refused.
    assert oaisys_here(*options, "--position", "-4", "0", "9").returncode == 2
    assert (out / "state.json").is_file()


def test_heights_on_the_ground_are_counted_from_the_surface_there() -> None:
    world = config_from_mapping(yaml.safe_load(WORLD.replace("plane", "mounds")))
    eye_m, target_m = (-4.0, -2.0, 1.5), (3.0, 1.0, 0.25)
    with closing(Simulation(world)) as simulation:
        simulation.step_batch()
        (request,) = ViewSteps(eye_m, target_m, 1, is_on_ground=True).requests(simulation)
        below_m = simulation.query_height([eye_m, target_m]).surface_height_m
    assert abs(below_m).min() > 0.01, "the ground would be where z is counted from anyway"
    assert request.metadata.sensor is not None
    T_map_rig = pose_to_matrix(request.metadata.sensor["pose"])
    eye, target = np.array([eye_m, target_m]) + np.outer(below_m, (0, 0, 1))
    np.testing.assert_allclose(T_map_rig[:3, 3], eye)
    towards = (target - eye) / np.linalg.norm(target - eye)
    np.testing.assert_allclose(T_map_rig[:3, 0], towards, atol=1e-9)


def test_a_point_off_the_ground_has_no_height_to_count_from() -> None:
    world = yaml.safe_load(WORLD)
    world["environment"] = {"ground_beyond": False}
    with closing(Simulation(config_from_mapping(world))) as simulation:
        simulation.step_batch()
        steps = ViewSteps((0.0, 0.0, 1.0), (90.0, 0.0, 0.0), 1, is_on_ground=True)
        with pytest.raises(InvalidInputError, match=r"look-at: received .*over the ground"):
            steps.requests(simulation)


def test_on_ground_needs_a_view() -> None:
    refused = oaisys_here("render", "--on-ground", "--out", "never")
    assert refused.returncode == 2
    assert "on-ground: received True, expected none without --position" in refused.stderr
