"""Cores: the share of a sample that only one core can work on, and what more cores would bring."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings, say_of_part

QUALITIES = ("geometry", "preview", "standard")
SERIAL_PERCENT = {"preview": 25.0}
EXPECTED_CORES = (8, 16)
MIN_CAPACITY = 1.2

Turns = Sequence[Mapping[str, Any]]
"""What the job ``cores.time_samples`` returned in each turn."""


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return seconds on one and on all cores, in turns, and the serial share that follows."""
    usable = sorted(os.sched_getaffinity(0))
    if len(usable) == 1:
        raise ValueError("received 1 usable core, expected at least 2 to compare with one")
    found: dict[int, list[Any]] = {1: [], len(usable): []}
    for turn in range(settings.runs):
        order = list(found)[:: 1 if turn % 2 == 0 else -1]
        for place, cores in enumerate(order):
            text = f"turn {turn + 1}, {cores} cores"
            part = say_of_part(say, 2 * turn + place, 2 * settings.runs, text)
            job = run_job("cores.time_samples", settings, part, cores=usable[:cores], count=cores)
            found[cores].append(job)
    return core_figures(found[1], found[len(usable)], len(usable))


def core_figures(one: Turns, all_: Turns, cores: int) -> list[Figure]:
    """Return the figures of runs on one core and on all.

    Args:
        one, all_: Results by turn.
        cores: Number of all cores.
    """
    sampling_one_s, sampling_all_s = _values(one, "sampling_s"), _values(all_, "sampling_s")
    capacity = median(sampling_one_s) / median(sampling_all_s)
    note = f"times as fast {cores} cores only sample the frozen scene; {cores} if they were whole"
    if capacity < MIN_CAPACITY:
        note += "; other programs used them, so the shares below mean nothing"
    figures = [figure("cores_capacity", "x", [capacity], note=note)]
    for quality in QUALITIES:
        one_s, all_s = (_values(turns, quality, "s") for turns in (one, all_))
        figures += [
            figure(f"cores_{quality}_1_s", "s", one_s),
            figure(f"cores_{quality}_{cores}_s", "s", all_s),
        ]
        figures += _shares(quality, one_s, all_s, capacity, cores)
        figures.append(_one_busy(quality, all_, cores))
    return figures


def serial_share(one_s: float, all_s: float, cores: float) -> float:
    """Return the share of one core's time that more cores do not shorten.

    By Amdahl's law (AFIPS Spring Joint Computer Conference, 1967) a run that takes T(1) on one core
    takes T(p) = T(1) · (s + (1 − s) / p) on p. Solved for s, with the speedup ψ = T(1) / T(p):
    s = (1/ψ − 1/p) / (1 − 1/p), the experimentally determined serial fraction (Karp, Flatt: CACM
    33(5), 1990).

    Args:
        one_s: T(1).
        all_s: T(p).
        cores: p; where cores share parts of the processor, as many whole cores as they are worth.
    """
    return (all_s / one_s - 1 / cores) / (1 - 1 / cores)


def seconds_by_amdahl(one_s: float, share: float, cores: int) -> float:
    """Return the seconds on a number of cores by Amdahl's law, see `serial_share`."""
    return one_s * (share + (1 - share) / cores)


def _shares(
    quality: str, one_s: Sequence[float], all_s: Sequence[float], capacity: float, cores: int
) -> list[Figure]:
    """Return serial shares by Amdahl's law, and the times to expect on more cores."""
    one, whole = median(one_s), median(all_s)
    limit = SERIAL_PERCENT.get(quality)
    goal = None if limit is None else Goal(limit)
    share = serial_share(one, whole, capacity)
    plain = 100 * serial_share(one, whole, cores)
    note = f"of one core's time, {cores} cores counted as {capacity:.2f}; as {cores}: {plain:.1f} %"
    figures = [figure(f"cores_{quality}_serial_share", "%", [100 * share], goal, note)]
    for more in EXPECTED_CORES:
        # Noise must not make more than all of it parallel.
        seconds = seconds_by_amdahl(one, max(share, 0.0), more)
        note = f"expected, {whole / seconds:.2f} times as fast as on {cores}"
        figures.append(figure(f"cores_{quality}_{more}_s", "s", [seconds], note=note))
    return figures


def _one_busy(quality: str, turns: Turns, cores: int) -> Figure:
    """Return the share of the time in which only one core is busy, by processor time.

    Were either one core busy or all, p cores would be busy for 1 + (1 − b)(p − 1) on average.
    """
    pairs = zip(_values(turns, quality, "cpu_s"), _values(turns, quality, "s"), strict=True)
    shares = [100 * (cores - cpu_s / wall_s) / (cores - 1) for cpu_s, wall_s in pairs]
    note = f"of the time on {cores} cores, by the process's processor time; other processes count"
    return figure(f"cores_{quality}_one_busy", "%", shares, note=note)


def _values(turns: Turns, *keys: str) -> list[float]:
    found = []
    for turn in turns:
        part: Any = turn
        for key in keys:
            part = part[key]
        found += part
    return found
