"""The schedule of a drive: every measurement that is due, once, in the order of time."""

from __future__ import annotations

from itertools import pairwise

import pytest

from oaisys_core.drive.schedule import SensorRate, SensorSchedule
from oaisys_core.errors import InvalidInputError

RATES = [
    SensorRate("camera", 10.0),
    SensorRate("lidar", 10.0, offset_s=0.02, duration_s=0.1),
    SensorRate("imu", 200.0),
    SensorRate("slow", 3.0),
]


def test_all_measurements_come_in_order_and_as_often_as_they_are_due() -> None:
    schedule = SensorSchedule(RATES, 5.0, 15.0)
    events = list(schedule)
    assert all(a.time_ns < b.time_ns for a, b in pairwise(events))
    counts = {rate.name: sum(rate.name in event.names for event in events) for rate in RATES}
    # The lidar's last revolution begins at 9.82 s; the one at 9.92 s would not be complete.
    assert counts == schedule.counts == {"camera": 100, "lidar": 99, "imu": 2000, "slow": 30}
    assert events[0].time_ns == 5_000_000_000
    assert events[0].names == ("camera", "imu", "slow")
    assert events[-1].time_ns == 14_995_000_000


def test_rounding_does_not_add_up() -> None:
    times_ns = SensorSchedule([SensorRate("slow", 3.0)], 0.0, 36_000.0).times_ns("slow")
    assert len(times_ns) == 108_000
    assert times_ns[-1] == 35_999_666_666_667


def test_stamps_since_1970_are_exact() -> None:
    times_ns = SensorSchedule([SensorRate("imu", 200.0)], 1.7e9, 1.7e9 + 1).times_ns("imu")
    assert times_ns.tolist() == [1_700_000_000_000_000_000 + 5_000_000 * k for k in range(200)]


def test_an_empty_drive_has_no_measurements() -> None:
    assert list(SensorSchedule(RATES, 1.0, 1.0)) == []
    assert list(SensorSchedule([], 0.0, 1.0)) == []


def test_names_that_are_not_unique_and_rates_of_zero_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="different names"):
        SensorSchedule([RATES[0], RATES[0]], 0.0, 1.0)
    with pytest.raises(InvalidInputError, match=r"sensors\.idle\.rate_hz"):
        SensorSchedule([SensorRate("idle", 0.0)], 0.0, 1.0)
