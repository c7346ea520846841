"""Movers during a drive: where simulated time says, however many sensors measure."""

from __future__ import annotations

from typing import Any

import pytest
from driven_world import DRIVEN_WORLD

from oaisys_core.config import config_from_mapping
from oaisys_core.drive.drive import Drive
from oaisys_core.errors import ConfigError
from oaisys_core.simulation import Simulation

WAY = {"waypoints_m": [[-8, 10], [8, 10]], "start_m": 1.0, "step_m": 0.5}


def mover(name: str, **way: Any) -> dict[str, Any]:
    look = {"shape": "boulder", "label": "boulder", "semantic_id": 24}
    return {"name": name, **look, "trajectory": WAY | way}


def world(*movers: dict[str, Any]) -> dict[str, Any]:
    return {**DRIVEN_WORLD, "assets": {"rocks": [], "movers": list(movers)}}


def xs_m(simulation: Simulation) -> list[float]:
    return [float(each.T_map_object[0, 0, 3]) for each in simulation.scene.placements]


def test_a_mover_with_a_speed_is_where_simulated_time_says() -> None:
    config = config_from_mapping(world(mover("timed", speed_m_s=3.0), mover("stepped")))
    simulation = Simulation(config)
    simulation.step_batch()
    assert xs_m(simulation) == pytest.approx([-7.0, -7.0])
    for step in Drive(simulation, config).samples():
        moved_m = [3.0 * step.time_ns / 1e9, 0.5 * step.sample.sample_id]
        assert xs_m(simulation) == pytest.approx([-7.0 + each for each in moved_m])
    last_m = xs_m(simulation)

    another = Simulation(config)
    another.restore(simulation.state())
    assert xs_m(another) == last_m
    assert xs_m_after_repeat(another, step.sample.outline) == last_m
    # Outside of the drive time stands still, and samples go on.
    simulation.step_sample()
    assert xs_m(simulation) == pytest.approx([last_m[0], last_m[1] + 0.5])
    simulation.step_batch()
    simulation.step_sample()
    assert xs_m(simulation) == pytest.approx([-6.5, -6.5])
    simulation.close()
    another.close()


def xs_m_after_repeat(simulation: Simulation, outline: Any) -> list[float]:
    simulation.repeat(outline)
    return xs_m(simulation)


def test_a_mover_on_a_file_of_poses_has_no_speed() -> None:
    way = {"csv": __file__, "speed_m_s": 1.0}
    with pytest.raises(ConfigError, match="speed_m_s needs waypoints_m"):
        config_from_mapping(world({**mover("filed"), "trajectory": way}))
