"""When each sensor of a drive measures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError

NANOSECONDS = 1_000_000_000


@dataclass(frozen=True)
class SensorRate:
    """How often a sensor measures.

    Attributes:
        name: Name of the sensor.
        rate_hz: Measurements per second.
        offset_s: Time from the start of the drive to the first measurement.
        duration_s: Time that a measurement takes, from its stamp on, such as a lidar's revolution;
            0 if it is instantaneous.
    """

    name: str
    rate_hz: float
    offset_s: float = 0.0
    duration_s: float = 0.0


@dataclass(frozen=True)
class ScheduledTime:
    """The sensors that measure at one time.

    Attributes:
        time_ns: Simulated time.
        names: Names of the sensors, in the order of the schedule.
    """

    time_ns: int
    names: tuple[str, ...]


class SensorSchedule:
    """The times at which the sensors of a drive measure, merged in order.

    The k-th measurement of a sensor is at ``start + offset + k / rate``, rounded to nanoseconds, so
    that rounding errors do not add up. The end is exclusive for instantaneous measurements; those
    that take time must be complete at the end.
    """

    def __init__(self, rates: Sequence[SensorRate], start_s: float, end_s: float) -> None:
        """Plan all measurements from ``start_s`` to ``end_s``.

        Raises:
            InvalidInputError: Two sensors share a name, or a rate is not positive.
        """
        self._times_ns: dict[str, NDArray[np.int64]] = {}
        for rate in rates:
            if rate.name in self._times_ns:
                raise InvalidInputError("sensors", rate.name, "sensors with different names")
            if not rate.rate_hz > 0:
                raise InvalidInputError(f"sensors.{rate.name}.rate_hz", rate.rate_hz, "above 0")
            self._times_ns[rate.name] = _times_ns(rate, start_s, end_s)

    @property
    def counts(self) -> dict[str, int]:
        """The number of measurements that are due, by sensor."""
        return {name: len(times_ns) for name, times_ns in self._times_ns.items()}

    def times_ns(self, name: str) -> NDArray[np.int64]:
        """Return the (N,) times of a sensor's measurements."""
        return self._times_ns[name]

    def __iter__(self) -> Iterator[ScheduledTime]:
        """Yield each time at which a sensor measures, in order."""
        names = list(self._times_ns)
        times_ns = np.concatenate([np.empty(0, np.int64), *self._times_ns.values()])
        sensors = np.repeat(np.arange(len(names)), list(self.counts.values()))
        order = np.lexsort((sensors, times_ns))
        times_ns, sensors = times_ns[order], sensors[order]
        begins = np.flatnonzero(np.diff(times_ns, prepend=times_ns[:1] - 1))
        ends = np.append(begins[1:], len(times_ns))[: len(begins)]
        for begin, end in zip(begins, ends, strict=True):
            due = tuple(names[sensor] for sensor in sensors[begin:end])
            yield ScheduledTime(int(times_ns[begin]), due)


def _times_ns(rate: SensorRate, start_s: float, end_s: float) -> NDArray[np.int64]:
    start_ns, end_ns = (round(time_s * NANOSECONDS) for time_s in (start_s, end_s))
    most = max(0, int((end_s - start_s - rate.offset_s) * rate.rate_hz) + 2)
    since_start_s = rate.offset_s + np.arange(most) / rate.rate_hz
    times_ns = start_ns + np.rint(since_start_s * NANOSECONDS).astype(np.int64)
    duration_ns = round(rate.duration_s * NANOSECONDS)
    is_due = times_ns + duration_ns <= end_ns if duration_ns else times_ns < end_ns
    return np.asarray(times_ns[is_due])
