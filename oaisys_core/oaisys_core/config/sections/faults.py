"""What real sensors do to true depth and true poses."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from oaisys_core.config.section import Section
from oaisys_core.sensing.faults import DepthFaults

FARTHEST_M = 1e6

Distance = Annotated[float, Field(ge=0, le=FARTHEST_M)]


class FaultsConfig(Section):
    """Noise of depth, and drift of what the rig takes for its pose; none by default.

    All is drawn by (seed, batch, sample, sensor): a sample that is rendered again has the same. The
    bridge's parameters ``faults.*`` of the same names and values do the same to what it publishes;
    where both are set, images suffer twice.

    Attributes:
        enabled: Whether any of it happens; a sample whose metadata says ``false`` is true.
        seed: Root of all draws.
        depth_noise: Law of the error of a depth z: ``gaussian`` has a standard deviation of
            ``depth_sigma_m``, ``quadratic`` of ``depth_sigma_m + depth_sigma_per_m * z**2``,
            ``kinect`` that of structured light.
        depth_sigma_m: See ``depth_noise``.
        depth_sigma_per_m: See ``depth_noise``; 1/m.
        min_depth_m: What is measured nearer becomes -inf.
        max_depth_m: What is measured farther becomes +inf; 0: no limit.
        missing_ratio: Share of depth pixels that become NaN.
        drift_m: Standard deviation of what odometry drifts along each axis with every sample.
        drift_rad: Standard deviation of what odometry turns about each axis with every sample.
    """

    enabled: bool = True
    seed: int = Field(default=0, ge=0, lt=2**63)
    depth_noise: Literal["none", "gaussian", "quadratic", "kinect"] = "none"
    depth_sigma_m: Distance = 0.01
    depth_sigma_per_m: float = Field(default=0.001, ge=0, le=1000)
    min_depth_m: Distance = 0.0
    max_depth_m: Distance = 0.0
    missing_ratio: float = Field(default=0.0, ge=0, le=1)
    drift_m: float = Field(default=0.0, ge=0, le=1000)
    drift_rad: float = Field(default=0.0, ge=0, le=3.2)

    @property
    def of_depth(self) -> DepthFaults:
        """What happens to depth images."""
        if not self.enabled:
            return DepthFaults()
        return DepthFaults(
            seed=self.seed,
            noise=self.depth_noise,
            sigma_m=self.depth_sigma_m,
            sigma_per_m=self.depth_sigma_per_m,
            min_depth_m=self.min_depth_m,
            max_depth_m=self.max_depth_m,
            missing_ratio=self.missing_ratio,
        )

    @property
    def drift_sigmas(self) -> tuple[float, float]:
        """Standard deviation of odometry's step along each axis (m) and about it (rad)."""
        return (self.drift_m, self.drift_rad) if self.enabled else (0.0, 0.0)

    @model_validator(mode="after")
    def _ordered(self) -> FaultsConfig:
        if 0 < self.max_depth_m <= self.min_depth_m:
            raise ValueError("max_depth_m must be above min_depth_m, or 0 for no limit")
        return self
