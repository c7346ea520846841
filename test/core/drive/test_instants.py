"""The instants of a drive: each measurement once, in order, however they are asked for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import pairwise

import pytest
from driven_world import DRIVEN_WORLD, DUE

from oaisys_core.config import config_from_mapping
from oaisys_core.drive.drive import Drive
from oaisys_core.drive.instants import DriveTimes
from oaisys_core.errors import InvalidInputError
from oaisys_core.simulation import Simulation
from oaisys_core.trajectory.planning import change_drive
from oaisys_core.types import DriveInstant

CONFIG = config_from_mapping(DRIVEN_WORLD)


@pytest.fixture(scope="module")
def simulation() -> Iterator[Simulation]:
    simulation = Simulation(CONFIG)
    simulation.step_batch()
    yield simulation
    simulation.close()


def counts(instants: list[DriveInstant]) -> Counter[str]:
    found = Counter({"odometry": sum(instant.has_odometry for instant in instants)})
    for instant in instants:
        found.update([*instant.sensors, *(reading.sensor for reading in instant.imus)])
    return found


def test_instants_have_each_measurement_that_is_due_in_blocks_as_at_once(
    simulation: Simulation,
) -> None:
    times = DriveTimes(Drive(simulation, CONFIG))
    instants = times.instants(0, len(times))
    assert counts(instants) == DUE
    assert all(a.time_ns < b.time_ns for a, b in pairwise(instants))
    blocks = [each for first in range(0, len(times), 7) for each in times.instants(first, 7)]
    assert blocks == instants
    assert times.instants(len(times), 5) == []


def test_only_chosen_sensors_measure(simulation: Simulation) -> None:
    drive = Drive(simulation, CONFIG, sensors=["side", "odometry"])
    times = DriveTimes(drive)
    assert counts(times.instants(0, 1000)) == {"side": 4, "odometry": 20}
    with pytest.raises(InvalidInputError, match="did you mean side"):
        Drive(simulation, CONFIG, sensors=["sid"])


def test_a_drive_with_too_many_measurements_is_refused_before_it_is_scheduled(
    simulation: Simulation,
) -> None:
    sensors = {**DRIVEN_WORLD["sensors"], "imus": [{"rate_hz": 1e5}]}
    drive = {"vehicle": {"kind": "drone", "hover_s": 60}, "waypoints_m": [[0, 0, 9]]}
    config = config_from_mapping({**DRIVEN_WORLD, "sensors": sensors, "drive": drive})
    with pytest.raises(InvalidInputError, match="at most 5000000 measurements"):
        Drive(simulation, config)


def test_a_request_replaces_keys_of_the_configured_drive() -> None:
    configured = CONFIG.drive
    changed = change_drive(configured, {"waypoints_m": [[0, 0], [1, 1]], "gravity": "mars"})
    assert (changed.waypoints_m, changed.duration_s) == (((0, 0), (1, 1)), None)
    assert (changed.gravity_m_s2, changed.odometry_rate_hz) == (3.728, 20.0)
    assert change_drive(configured, {"gravity": 2}).duration_s == 1.0
    assert change_drive(configured, {}) == configured
    with pytest.raises(InvalidInputError) as caught:
        change_drive(configured, {"vehicle": {"kind": "rover", "speed_m_s": -1}})
    assert caught.value.field == "drive.vehicle.speed_m_s"
    with pytest.raises(InvalidInputError, match="waypoints"):
        change_drive(None, {"gravity": "mars"})
