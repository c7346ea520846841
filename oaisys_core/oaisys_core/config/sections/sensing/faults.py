"""Configuration of sensor faults: noise of depth images and drift of odometry."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from oaisys_core.config.section import Section
from oaisys_core.sensing.faults import DepthFaults

FARTHEST_M = 1e6

Distance = Annotated[float, Field(ge=0, le=FARTHEST_M)]


class FaultsConfig(Section):
    """Noise of depth images and drift of the estimated rig pose; none by default.

    All faults are drawn from (seed, batch, sample, sensor), so a sample that is rendered again has
    the same ones. The parameters ``faults.*`` of the ROS bridge have the same names and effects; if
    both are set, the faults are applied twice. They change ``depth`` and ``range``; the modalities
    ``depth_true`` and ``range_true`` show the same view without them.

    Attributes:
        enabled: Whether faults are applied; metadata may turn them off for a sample.
        seed: Root seed of the faults.
        batch: Number that stands for the batch's in these draws, so that a world that is built
            again has the same faults; null: its own, so that no two batches have the same.
        depth_noise: Noise model of a depth z: ``gaussian`` with standard deviation
            ``depth_sigma_m``, ``quadratic`` with ``depth_sigma_m + depth_sigma_per_m * z**2``, or
            ``kinect`` for structured light.
        depth_sigma_m: See ``depth_noise``.
        depth_sigma_per_m: See ``depth_noise``; 1/m.
        min_depth_m: Smaller depths become -inf.
        max_depth_m: Larger depths become +inf; 0 for no limit.
        missing_ratio: Share of depth pixels that become NaN.
        drift_m: Standard deviation of the odometry's drift per sample along each axis.
        drift_rad: Standard deviation of the odometry's rotation drift per sample about each axis.
    """

    enabled: bool = True
    seed: int = Field(default=0, ge=0, lt=2**63)
    batch: int | None = Field(default=None, ge=0, lt=2**63)
    depth_noise: Literal["none", "gaussian", "quadratic", "kinect"] = "none"
    depth_sigma_m: Distance = 0.01
    depth_sigma_per_m: float = Field(default=0.001, ge=0, le=1000)
    min_depth_m: Distance = 0.0
    max_depth_m: Distance = 0.0
    missing_ratio: float = Field(default=0.0, ge=0, le=1)
    drift_m: float = Field(default=0.0, ge=0, le=1000)
    drift_rad: float = Field(default=0.0, ge=0, le=3.2)

    @property
    def of_depth(self) -> DepthFaults | None:
        """The faults of depth images; None if there are none."""
        faults = DepthFaults(
            seed=self.seed,
            noise=self.depth_noise,
            sigma_m=self.depth_sigma_m,
            sigma_per_m=self.depth_sigma_per_m,
            min_depth_m=self.min_depth_m,
            max_depth_m=self.max_depth_m,
            missing_ratio=self.missing_ratio,
        )
        return faults if self.enabled and faults.active else None

    @property
    def drift_sigmas(self) -> tuple[float, float]:
        """Standard deviations of the odometry's drift per sample, in metres and radians."""
        return (self.drift_m, self.drift_rad) if self.enabled else (0.0, 0.0)

    @model_validator(mode="after")
    def _check_order(self) -> FaultsConfig:
        if 0 < self.max_depth_m <= self.min_depth_m:
            raise ValueError("max_depth_m must be above min_depth_m, or 0 for no limit")
        return self
