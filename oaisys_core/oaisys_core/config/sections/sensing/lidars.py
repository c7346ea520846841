"""Configuration of lidars: where they sit, how they scan, what they measure, and their faults."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from oaisys_core.config.section import (
    LEAST_RATE_HZ,
    ByKind,
    Position,
    Positive,
    Quaternion,
    Section,
)
from oaisys_core.files.path_fields import ConfigFile
from oaisys_core.geometry import MAX_M

MAX_RAYS = 4_000_000
"""Largest number of rays of a scan."""

Elevation = Annotated[float, Field(ge=-90, le=90)]
Azimuth = Annotated[float, Field(ge=-360, le=360)]
Count = Annotated[int, Field(ge=1, le=MAX_RAYS)]

LidarPreset = Literal["generic_16", "generic_32", "generic_64", "generic_128"]

_PRESETS: Mapping[str, Mapping[str, float]] = {
    "generic_16": {"channels": 16, "elevation_min_deg": -15.0, "elevation_max_deg": 15.0},
    "generic_32": {"channels": 32, "elevation_min_deg": -25.0, "elevation_max_deg": 15.0},
    "generic_64": {"channels": 64, "elevation_min_deg": -24.8, "elevation_max_deg": 2.0},
    "generic_128": {"channels": 128, "elevation_min_deg": -22.5, "elevation_max_deg": 22.5},
}


class RotatingScanConfig(Section):
    """A column of channels that turns counter-clockwise, seen from above, at a constant rate.

    All channels of a column fire together. Ring 0 is the lowest channel.

    Attributes:
        kind: ``rotating``.
        preset: Channels and elevations that are used unless they are given: ``generic_16`` from -15
            to 15 degrees, ``generic_32`` from -25 to 15, ``generic_64`` from -24.8 to 2, and
            ``generic_128`` from -22.5 to 22.5; None for the defaults.
        channels: Number of channels, evenly spaced in elevation.
        azimuth_steps: Number of columns.
        elevation_min_deg, elevation_max_deg: Elevations of the lowest and the highest channel.
        elevations_deg: Elevation of each channel from the lowest on, instead of even spacing;
            ``channels`` is then their number.
        azimuth_min_deg, azimuth_max_deg: Azimuths between which it turns; 0 is ahead (x) and 90 to
            the left (y).
    """

    kind: Literal["rotating"] = "rotating"
    preset: LidarPreset | None = None
    channels: Annotated[int, Field(ge=1, le=4096)] = 64
    azimuth_steps: Count = 1024
    elevation_min_deg: Elevation = -24.8
    elevation_max_deg: Elevation = 2.0
    elevations_deg: tuple[Elevation, ...] = ()
    azimuth_min_deg: Azimuth = -180.0
    azimuth_max_deg: Azimuth = 180.0

    @model_validator(mode="before")
    @classmethod
    def _with_preset(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        filled = {**_PRESETS.get(str(data.get("preset")), {}), **data}
        elevations = data.get("elevations_deg")
        if isinstance(elevations, list | tuple) and elevations:
            filled.setdefault("channels", len(elevations))
        return filled

    @model_validator(mode="after")
    def _consistent(self) -> RotatingScanConfig:
        if self.elevation_min_deg > self.elevation_max_deg:
            raise ValueError("elevation_min_deg must not be above elevation_max_deg")
        if self.elevations_deg and list(self.elevations_deg) != sorted(self.elevations_deg):
            raise ValueError("elevations_deg must ascend")
        if self.elevations_deg and len(self.elevations_deg) != self.channels:
            raise ValueError(f"elevations_deg must have {self.channels} values, one per channel")
        if not 0 < self.azimuth_max_deg - self.azimuth_min_deg <= 360:
            raise ValueError("azimuth_max_deg must be above azimuth_min_deg by at most 360")
        return self

    @property
    def ray_count(self) -> int:
        """Number of rays of a scan."""
        return self.channels * self.azimuth_steps


class RosetteScanConfig(Section):
    """A rosette around the x axis that two rotating wedge prisms draw, as in Livox's Mid-40.

    The formula is in `oaisys_core.procedural.lidar_patterns`. The rosette continues from scan to
    scan, so that its petals fill the field of view with time.

    Attributes:
        kind: ``rosette``.
        points: Rays per scan, evenly spaced in time.
        field_of_view_deg: Diameter of the field of view.
        first_prism_hz, second_prism_hz: Turns of the prisms per second; a negative number turns
            the other way.
    """

    kind: Literal["rosette"]
    points: Count = 10_000
    field_of_view_deg: Annotated[float, Field(gt=0, lt=180)] = 38.4
    first_prism_hz: Annotated[float, Field(ge=-1e4, le=1e4)] = 7294 / 60
    second_prism_hz: Annotated[float, Field(ge=-1e4, le=1e4)] = -4664 / 60

    @property
    def ray_count(self) -> int:
        """Number of rays of a scan."""
        return self.points


class RasterScanConfig(Section):
    """A solid-state lidar that scans row by row, from the top and from left to right.

    Ring 0 is the lowest row.

    Attributes:
        kind: ``raster``.
        columns, rows: Number of rays in a row, and of rows.
        horizontal_fov_deg, vertical_fov_deg: Angles between the outer columns and rows.
    """

    kind: Literal["raster"]
    columns: Count = 320
    rows: Count = 120
    horizontal_fov_deg: Annotated[float, Field(gt=0, le=180)] = 120.0
    vertical_fov_deg: Annotated[float, Field(gt=0, le=180)] = 25.0

    @property
    def ray_count(self) -> int:
        """Number of rays of a scan."""
        return self.columns * self.rows


class CsvScanConfig(Section):
    """Rays from a file.

    Attributes:
        kind: ``csv``.
        path: CSV file with the columns ``azimuth_deg``, ``elevation_deg``, ``time_s`` since the
            beginning of the scan, and optionally ``ring``; relative to the configuration file.
    """

    kind: Literal["csv"]
    path: ConfigFile

    @property
    def ray_count(self) -> int:
        """0: known when the file is read."""
        return 0


AnyScan = Annotated[
    RotatingScanConfig | RosetteScanConfig | RasterScanConfig | CsvScanConfig,
    ByKind(),
]


class LidarFaultsConfig(Section):
    """Errors of a lidar, drawn from (seed, batch, sample, sensor); none by default.

    Attributes:
        seed: Root seed of the errors.
        range_sigma_m: Standard deviation of the range, normal with mean 0.
        drop_from_deg: Angle of incidence from which rays are lost: the share of lost rays rises
            linearly from 0 at this angle to 1 at 90 degrees; None: no ray is lost.
    """

    seed: int = Field(default=0, ge=0, lt=2**63)
    range_sigma_m: float = Field(default=0.0, ge=0, le=100)
    drop_from_deg: Annotated[float, Field(ge=0, lt=90)] | None = None


class LidarConfig(Section):
    """A lidar on the rig.

    Attributes:
        name: Name of the sensor, its folder and its topics.
        mount_position_m, mount_quat_xyzw: Pose of the lidar's link (x forward, z up) in
            ``base_link``.
        scan: Directions and times of the rays.
        period_s: Duration of a scan.
        sweep_share: Share of the motion since the lidar's previous sample that happens during a
            scan: the lidar goes on at that velocity, and each ray starts where the lidar is at the
            ray's own time. 0: it stands still during a scan.
        min_range_m, max_range_m: Ranges that it measures; other rays return nothing.
        reference_range_m: Range up to which the intensity does not depend on the range; beyond, it
            falls with the square of the range.
        beam_divergence_mrad: Full angle of the beam. Above 0, a beam that meets two surfaces gives
            two returns; 0: an infinitely thin beam.
        return_separation_m: Least distance of two returns of a beam.
        extra_fields: Further fields of the points: ``label``, the semantic id on level 0, and
            ``instance``, the instance id.
        step_interval: Samples from one scan to the next.
        step_offset: Samples before the first scan.
        rate_hz: Scans per second of a timed drive.
        faults: Errors of the measurements.
    """

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=64)] = "lidar"
    mount_position_m: Position = (0.0, 0.0, 0.0)
    mount_quat_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)
    scan: AnyScan = RotatingScanConfig()
    period_s: float = Field(default=0.1, ge=1e-6, le=3600)
    sweep_share: float = Field(default=0.0, ge=0, le=1)
    min_range_m: float = Field(default=0.5, ge=0, le=MAX_M)
    max_range_m: Annotated[Positive, Field(le=MAX_M)] = 120.0
    reference_range_m: Annotated[Positive, Field(le=MAX_M)] = 10.0
    beam_divergence_mrad: float = Field(default=0.0, ge=0, le=100)
    return_separation_m: Annotated[Positive, Field(le=1000)] = 0.5
    extra_fields: tuple[Literal["label", "instance"], ...] = ()
    step_interval: int = Field(default=1, ge=1)
    step_offset: int = Field(default=0, ge=0)
    rate_hz: float = Field(default=10.0, ge=LEAST_RATE_HZ, le=10_000)
    faults: LidarFaultsConfig = LidarFaultsConfig()

    @model_validator(mode="after")
    def _consistent(self) -> LidarConfig:
        if self.min_range_m >= self.max_range_m:
            raise ValueError("max_range_m must be above min_range_m")
        if self.scan.ray_count > MAX_RAYS:
            raise ValueError(f"a scan has at most {MAX_RAYS} rays")
        if len(set(self.extra_fields)) != len(self.extra_fields):
            raise ValueError("extra_fields must differ")
        return self
