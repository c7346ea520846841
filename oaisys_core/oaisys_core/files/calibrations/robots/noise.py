"""SDF's ``<noise>``: what of it we have."""

from __future__ import annotations

from dataclasses import dataclass

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.calibrations.robots.elements import XmlElement


@dataclass(frozen=True)
class GaussianNoise:
    """Noise of a measurement, and of its bias, as `gz::sensors::GaussianNoiseModel` draws it.

    Attributes:
        mean, stddev: Of each measurement.
        bias_mean, bias_stddev: Of the bias, which is drawn once.
        walk_stddev: Of the bias's rate, per square root of a second.
        walk_time_s: Correlation time of the bias; 0: it stays as it was drawn.
    """

    mean: float = 0.0
    stddev: float = 0.0
    bias_mean: float = 0.0
    bias_stddev: float = 0.0
    walk_stddev: float = 0.0
    walk_time_s: float = 0.0


KINDS = ("gaussian", "gaussian_quantized")


def read_noise(parent: XmlElement | None) -> GaussianNoise:
    """Return the noise in an element; none if there is no element or no noise in it.

    Raises:
        InvalidInputError: It is of a kind that we lack, or a number is wrong.
    """
    noise = None if parent is None else parent.child("noise")
    if noise is None:
        return GaussianNoise()
    kind = noise.attributes.get("type") or noise.value("type", "none")
    if kind == "none":
        return GaussianNoise()
    if kind not in KINDS:
        raise InvalidInputError(noise.where, f"type {kind!r}", f"none, {' or '.join(KINDS)}")
    return read_numbers(noise)


def read_numbers(noise: XmlElement) -> GaussianNoise:
    """Return the noise whose numbers an element has.

    Raises:
        InvalidInputError: One is not finite, or a standard deviation is negative.
    """
    found = GaussianNoise(
        mean=noise.number("mean", 0.0),
        stddev=noise.number("stddev", 0.0),
        bias_mean=noise.number("bias_mean", 0.0),
        bias_stddev=noise.number("bias_stddev", 0.0),
        walk_stddev=noise.number("dynamic_bias_stddev", 0.0),
        walk_time_s=noise.number("dynamic_bias_correlation_time", 0.0),
    )
    for name in ("stddev", "bias_stddev", "walk_stddev", "walk_time_s"):
        if (value := getattr(found, name)) < 0:
            raise InvalidInputError(noise.where, f"{name} {value:g}", "a number not below 0")
    return found
