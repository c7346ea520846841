"""The rays of lidars: directions and times of a scan.

Azimuth turns from x (ahead) to y (left), elevation upwards; both in the lidar's frame.

* Rotating: column j of n fires at ``j / n`` of the period, all its channels together.
* Rosette: two wedge prisms, each of which deflects the beam by half of the field of view's radius,
  turn at the rates f1 and f2. To first order the deflections add up as vectors (the paraxial
  Risley prism, G. F. Marshall, "Risley prism scan patterns", Proc. SPIE 3787, 1999)::

      a(t) = r / 2 * (cos(2 pi f1 t) + cos(2 pi f2 t))      to the left
      b(t) = r / 2 * (sin(2 pi f1 t) + sin(2 pi f2 t))      upwards

  where r is the radius of the field of view; the ray is turned away from x by the angle
  ``hypot(a, b)`` towards (a, b). The default rates are those of Livox's Mid-40 (R. G. Brazeal et
  al., "A rigorous observation model for the Risley prism-based Livox Mid-40 lidar sensor",
  Sensors 21, 2021).
* Raster: row by row, at a constant rate.
"""

from __future__ import annotations

from functools import lru_cache
from math import pi, radians
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config.sections.sensing.lidars import (
    MAX_RAYS,
    CsvScanConfig,
    LidarConfig,
    RasterScanConfig,
    RosetteScanConfig,
    RotatingScanConfig,
)
from oaisys_core.errors import ConfigError, quote
from oaisys_core.files.csv_tables import read_csv
from oaisys_core.files.numbers import float_of, int_of
from oaisys_core.scene import ScanPattern
from oaisys_core.types import FloatArray

CSV_COLUMNS = ("azimuth_deg", "elevation_deg", "time_s")
MAX_RING = 65535


def scan_pattern(config: LidarConfig, number: int) -> ScanPattern:
    """Return the rays of a lidar's scan.

    Args:
        config: The lidar.
        number: Number of the scan, from 0; a rosette goes on from scan to scan.

    Raises:
        ConfigError: The file with the rays cannot be used.
    """
    scan = config.scan
    if isinstance(scan, RosetteScanConfig):
        return rosette(scan, config.period_s, number * config.period_s)
    if isinstance(scan, CsvScanConfig):
        return _from_file(scan.path)
    if isinstance(scan, RasterScanConfig):
        return raster(scan, config.period_s)
    return rotating(scan, config.period_s)


@lru_cache(maxsize=8)
def rotating(scan: RotatingScanConfig, period_s: float) -> ScanPattern:
    """Return the rays of a rotating lidar, column by column, the lowest channel first."""
    elevations_deg = scan.elevations_deg or np.linspace(
        scan.elevation_min_deg, scan.elevation_max_deg, scan.channels
    )
    steps = np.arange(scan.azimuth_steps) / scan.azimuth_steps
    span_deg = scan.azimuth_max_deg - scan.azimuth_min_deg
    azimuth, elevation = np.meshgrid(
        np.radians(scan.azimuth_min_deg + span_deg * steps),
        np.radians(elevations_deg),
        indexing="ij",
    )
    return ScanPattern(
        directions=directions_of(azimuth.ravel(), elevation.ravel()),
        times_s=np.repeat(steps * period_s, scan.channels),
        rings=np.tile(np.arange(scan.channels, dtype=np.uint16), scan.azimuth_steps),
    )


def rosette(scan: RosetteScanConfig, period_s: float, start_s: float) -> ScanPattern:
    """Return the rays of a scan that begins ``start_s`` after the prisms were aligned."""
    times_s = np.arange(scan.points) / scan.points * period_s
    each = radians(scan.field_of_view_deg) / 4
    first = 2 * pi * scan.first_prism_hz * (start_s + times_s)
    second = 2 * pi * scan.second_prism_hz * (start_s + times_s)
    left = each * (np.cos(first) + np.cos(second))
    up = each * (np.sin(first) + np.sin(second))
    angle = np.hypot(left, up)
    # np.sinc(x) is sin(pi x) / (pi x), which is finite on the axis.
    ratio = np.sinc(angle / pi)
    directions = np.stack((np.cos(angle), ratio * left, ratio * up), axis=-1)
    return ScanPattern(directions, times_s, np.zeros(scan.points, np.uint16))


@lru_cache(maxsize=8)
def raster(scan: RasterScanConfig, period_s: float) -> ScanPattern:
    """Return the rays of a solid-state lidar, from the upper left to the lower right."""
    half_width, half_height = scan.horizontal_fov_deg / 2, scan.vertical_fov_deg / 2
    elevation, azimuth = np.meshgrid(
        np.radians(np.linspace(half_height, -half_height, scan.rows)),
        np.radians(np.linspace(half_width, -half_width, scan.columns)),
        indexing="ij",
    )
    count = scan.rows * scan.columns
    rings = np.repeat(np.arange(scan.rows)[::-1], scan.columns)
    return ScanPattern(
        directions=directions_of(azimuth.ravel(), elevation.ravel()),
        times_s=np.arange(count) / count * period_s,
        rings=np.minimum(rings, MAX_RING).astype(np.uint16),
    )


def directions_of(azimuth_rad: FloatArray, elevation_rad: FloatArray) -> FloatArray:
    """Return (N, 3) unit vectors of (N,) azimuths and elevations."""
    level = np.cos(elevation_rad)
    return np.stack(
        (level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), np.sin(elevation_rad)), axis=-1
    )


@lru_cache(maxsize=8)
def _from_file(path: Path) -> ScanPattern:
    """Return the rays of a file; see `CsvScanConfig`."""
    angles_deg, times_s, rings = _read(path)
    order = np.argsort(times_s, kind="stable")
    azimuth, elevation = np.radians(angles_deg[order]).T
    return ScanPattern(directions_of(azimuth, elevation), times_s[order], rings[order])


def _read(path: Path) -> tuple[FloatArray, FloatArray, NDArray[np.uint16]]:
    try:
        rows = read_csv(path, MAX_RAYS)
        values = np.array([[float_of(row[name]) for name in CSV_COLUMNS] for row in rows])
        rings = np.array([int_of(row.get("ring") or "0") for row in rows])
    except (OSError, UnicodeDecodeError, KeyError, TypeError, ValueError) as error:
        expected = f"a CSV file with numbers in the columns {', '.join(CSV_COLUMNS)}"
        raise ConfigError(f"{path}: expected {expected} ({quote(error)})") from error
    if not 0 < len(values) <= MAX_RAYS:
        raise ConfigError(f"{path}: {len(values)} rays, expected 1 to {MAX_RAYS}")
    if not np.isfinite(values).all() or values[:, 2].min() < 0:
        raise ConfigError(f"{path}: expected finite angles, and times from 0 on")
    if rings.min() < 0 or rings.max() > MAX_RING:
        raise ConfigError(f"{path}: expected rings from 0 to {MAX_RING}")
    return values[:, :2], values[:, 2], rings.astype(np.uint16)
