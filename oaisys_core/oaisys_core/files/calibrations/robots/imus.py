"""Gazebo's IMUs: ``<imu>`` of SDF, also inside of URDF."""

from __future__ import annotations

import math
from typing import Any

from oaisys_core.files.calibrations.robots.elements import XmlElement
from oaisys_core.files.calibrations.robots.noise import GaussianNoise, read_noise, read_numbers
from oaisys_core.files.calibrations.robots.records import Notes

AXES = ("x", "y", "z")
KEYS = {
    "gyroscope": ("angular_velocity", "rate", "gyroscope_bias_rad_s"),
    "accelerometer": ("linear_acceleration", "accel", "accelerometer_bias_m_s2"),
}
"""By ours: SDF's element, that of SDF before 1.5, and our key of the bias."""

DEFAULT_RATE_HZ = 200.0
"""That of an IMU in a configuration."""


def read_imu(sensor: XmlElement, name: str, rate_hz: float | None, notes: Notes) -> dict[str, Any]:
    """Return the keys of an IMU in a configuration, without its mount.

    A standard deviation s of each measurement at f Hz is a density of s / sqrt(f).

    Raises:
        InvalidInputError: A number is wrong, or the noise is of a kind that we lack.
    """
    imu = sensor.child("imu")
    rate = DEFAULT_RATE_HZ if rate_hz is None else rate_hz
    found: dict[str, Any] = {"name": name, "rate_hz": rate}
    for kind, (element, older, bias_key) in KEYS.items():
        axes = _axes(imu, element, older)
        stddev = _one(axes, "stddev", f"{name}: {kind}", notes)
        walk = _one(axes, "walk_stddev", f"{name}: {kind}", notes)
        if stddev:
            found[f"{kind}_noise_density"] = stddev / math.sqrt(rate)
        if walk:
            found[f"{kind}_random_walk"] = walk
            notes.add(f"{name}: the bias walks without dynamic_bias_correlation_time")
        bias = [axis.mean + axis.bias_mean for axis in axes]
        if any(bias):
            found[bias_key] = bias
            notes.add(f"{name}: its bias is mean + bias_mean; Gazebo draws the latter's sign")
        if any(axis.bias_stddev for axis in axes):
            notes.add(f"{name}: bias_stddev is not used: the first bias is the same each time")
    return found


def _axes(imu: XmlElement | None, element: str, older: str) -> tuple[GaussianNoise, ...]:
    """Return the noise of the three axes."""
    if imu is None:
        return (GaussianNoise(),) * 3
    group = imu.child(element)
    if group is not None:
        return tuple(read_noise(group.child(axis)) for axis in AXES)
    noise = imu.child("noise")
    if noise is None or (numbers := noise.child(older)) is None:
        return (GaussianNoise(),) * 3
    noise.child("type")
    return (read_numbers(numbers),) * 3


def _one(axes: tuple[GaussianNoise, ...], key: str, where: str, notes: Notes) -> float:
    """Return the value of all axes: their root mean square where they differ."""
    values = [float(getattr(axis, key)) for axis in axes]
    if len(set(values)) == 1:
        return values[0]
    shown = ", ".join(f"{value:g}" for value in values)
    notes.add(f"{where}: the axes' standard deviations {shown} become their root mean square")
    return math.sqrt(sum(value**2 for value in values) / len(values))
