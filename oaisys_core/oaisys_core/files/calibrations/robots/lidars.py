"""Gazebo's lidars: ``<ray>`` and ``<lidar>`` of SDF, also inside of URDF."""

from __future__ import annotations

import math
from typing import Any

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.calibrations.robots.elements import XmlElement
from oaisys_core.files.calibrations.robots.noise import read_noise
from oaisys_core.files.calibrations.robots.records import Notes

KINDS = ("ray", "gpu_ray", "lidar", "gpu_lidar")
TURN_DEG, SLACK_DEG = 360.0, 0.01
MOST_DEG = 370.0
"""A little more than a full turn, as of files that round pi generously."""

FARTHEST_M = 1e6
"""Greatest range that a configuration may have."""


def read_lidar(
    sensor: XmlElement, name: str, rate_hz: float | None, notes: Notes
) -> dict[str, Any]:
    """Return the keys of a lidar in a configuration, without its mount.

    Raises:
        InvalidInputError: A number is missing or wrong.
    """
    lidar = sensor.require("lidar", "ray")
    scan = lidar.require("scan")
    found: dict[str, Any] = {
        "name": name,
        "scan": {
            "kind": "rotating",
            **_vertical(scan.child("vertical"), name, notes),
            **_horizontal(scan.require("horizontal"), name, notes),
        },
    }
    if rate_hz is not None:
        found |= {"rate_hz": rate_hz, "period_s": 1 / rate_hz}
    notes.add("lidars turn once in 1 / rate_hz, where Gazebo measures all rays at once")
    found |= _range(lidar.require("range"))
    noise = read_noise(lidar)
    if noise.stddev:
        found["faults"] = {"range_sigma_m": noise.stddev}
    if noise.mean:
        notes.add(f"{name}: the mean {noise.mean:g} m of its noise is not used")
    return found


def _range(element: XmlElement) -> dict[str, float]:
    bounds = []
    for key in ("min", "max"):
        each = element.require(key)
        is_infinite = each.text.lower() in ("inf", "+inf", ".inf")
        bounds.append(FARTHEST_M if is_infinite else each.numbers(1)[0])
    least_m, most_m = bounds
    if not 0 <= least_m < most_m:
        raise InvalidInputError(element.where, f"{least_m:g} to {most_m:g}", "min below max")
    return {"min_range_m": least_m, "max_range_m": min(most_m, FARTHEST_M)}


def _angles(element: XmlElement, name: str, notes: Notes) -> tuple[int, float, float]:
    """Return the number of rays and the angles of the first and the last one, in degrees."""
    samples = element.number("samples")
    if samples < 1 or samples != int(samples):
        raise InvalidInputError(element.where, f"samples {samples:g}", "a whole number from 1 on")
    if (resolution := element.number("resolution", 1.0)) != 1:
        notes.add(f"{name}: the resolution {resolution:g} of its {element.tag} scan is not used")
    least, most = (math.degrees(element.number(key, 0.0)) for key in ("min_angle", "max_angle"))
    if least > most or (least == most and samples > 1):
        shown = f"{samples:g} samples from {least:g} to {most:g} degrees"
        raise InvalidInputError(element.where, shown, "max_angle above min_angle")
    if samples == 1 and least != most:
        notes.add(f"{name}: the only ray of its {element.tag} scan is at min_angle")
    return int(samples), least, most


def _vertical(element: XmlElement | None, name: str, notes: Notes) -> dict[str, float]:
    samples, least, most = (1, 0.0, 0.0) if element is None else _angles(element, name, notes)
    return {
        "channels": samples,
        "elevation_min_deg": least,
        "elevation_max_deg": most if samples > 1 else least,
    }


def _horizontal(element: XmlElement, name: str, notes: Notes) -> dict[str, float]:
    """Return the columns: Gazebo's last ray is at max_angle, ours one step before the end."""
    samples, least, most = _angles(element, name, notes)
    if most - least > MOST_DEG:
        expected = "angles in radians, about a full turn at most"
        raise InvalidInputError(element.where, f"{most - least:g} degrees", expected)
    if samples == 1:
        return _columns(1, least, least + 1.0)
    step = (most - least) / (samples - 1)
    columns = min(samples, int((TURN_DEG + SLACK_DEG) / step))
    if columns < samples:
        notes.add(
            f"{name}: of its {samples} columns the last {samples - columns} are left out, which are"
            f" less than a step of {step:.3g} degrees from the first, or beyond it"
        )
    return _columns(columns, least, min(least + columns * step, least + TURN_DEG))


def _columns(steps: int, start_deg: float, end_deg: float) -> dict[str, float]:
    turns = TURN_DEG if end_deg > TURN_DEG else -TURN_DEG if start_deg < -TURN_DEG else 0.0
    return {
        "azimuth_steps": steps,
        "azimuth_min_deg": start_deg - turns,
        "azimuth_max_deg": end_deg - turns,
    }
