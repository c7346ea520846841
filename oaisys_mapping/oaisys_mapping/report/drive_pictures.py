"""Pictures of a drive for its report: the way on a map, IMUs and odometry over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import LightSource
from matplotlib.figure import Figure

from oaisys_core.types import FloatArray, HeightGrid
from oaisys_mapping.report.pictures import PAGE_COLOR, figure_png

SUN_AZIMUTH_DEG, SUN_ALTITUDE_DEG = 315.0, 40.0
"""Light of shaded maps, from the north-west as on printed maps."""


def way_map(ground: HeightGrid, way_m: FloatArray, estimated_m: FloatArray | None) -> bytes:
    """Return a PNG map of the shaded heights with the way on it.

    Args:
        ground: Heights of the ground and of the objects on it.
        way_m: (N, 3) true positions.
        estimated_m: (N, 3) positions that odometry estimates; None if it does not drift.
    """
    figure = Figure(figsize=(8.4, 6.4), layout="constrained", facecolor=PAGE_COLOR)
    axes = figure.add_subplot()
    heights_m = np.where(
        np.isfinite(ground.surface_m), ground.surface_m, np.nanmin(ground.ground_m)
    )
    spacing_m = ground.spacing_m
    light = LightSource(SUN_AZIMUTH_DEG, SUN_ALTITUDE_DEG)
    # LightSource counts rows from the north.
    shade = light.hillshade(heights_m[::-1], dx=spacing_m, dy=spacing_m)[::-1]
    rows, columns = heights_m.shape
    west, south = np.array(ground.origin_xy_m) - spacing_m / 2
    extent = (west, west + columns * spacing_m, south, south + rows * spacing_m)
    shown = axes.imshow(ground.ground_m, origin="lower", extent=extent, cmap="YlOrBr")
    axes.imshow(shade, origin="lower", extent=extent, cmap="gray", alpha=0.45)
    axes.plot(way_m[:, 0], way_m[:, 1], color="white", lw=3.4)
    axes.plot(way_m[:, 0], way_m[:, 1], color="#b3261e", lw=1.8, label="true way")
    if estimated_m is not None:
        axes.plot(*estimated_m[:, :2].T, color="#1c2126", lw=1.4, ls="--", label="odometry")
    axes.plot(*way_m[0, :2], "o", color="#1d7a46", ms=8, label="start")
    axes.plot(*way_m[-1, :2], "s", color="#b3261e", ms=7, label="end")
    axes.legend(frameon=True, loc="best")
    axes.set(xlabel="x in metres (map)", ylabel="y in metres (map)", aspect="equal")
    figure.colorbar(shown, label="height of the ground in metres", shrink=0.85)
    return figure_png(figure)


def imu_chart(measurements: FloatArray) -> bytes:
    """Return a PNG of (N, 7) times, angular rates and specific forces of an IMU."""
    return _time_chart(
        measurements[:, 0],
        [
            ("angular rate, rad/s", ("x", "y", "z"), measurements[:, 1:4]),
            ("specific force, m/s²", ("x", "y", "z"), measurements[:, 4:7]),
        ],
    )


def odometry_chart(
    times_s: FloatArray,
    velocity_m_s: FloatArray,
    angular_rate_rad_s: FloatArray,
    error_m: FloatArray | None,
) -> bytes:
    """Return a PNG of true twists in ``base_link`` and, if it drifts, of odometry's error."""
    panels: list[tuple[str, Sequence[str], FloatArray]] = [
        ("velocity, m/s", ("x", "y", "z"), velocity_m_s),
        ("angular rate, rad/s", ("x", "y", "z"), angular_rate_rad_s),
    ]
    if error_m is not None:
        panels.append(("error of odometry, m", ("x", "y", "z"), error_m))
    return _time_chart(times_s, panels)


def _time_chart(
    times_s: FloatArray, panels: Sequence[tuple[str, Sequence[str], FloatArray]]
) -> bytes:
    figure = Figure(
        figsize=(10.2, 1.9 * len(panels) + 0.4), layout="constrained", facecolor=PAGE_COLOR
    )
    rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (title, names, values) in zip(rows, panels, strict=True):
        for name, column in zip(names, values.T, strict=True):
            axes.plot(times_s, column, lw=1.0, label=name)
        axes.set_ylabel(title)
        axes.set_facecolor("none")
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
        above = (1.0, 1.0)  # where it covers no curve
        axes.legend(
            frameon=False, ncols=len(names), loc="lower right", bbox_to_anchor=above, borderpad=0
        )
    rows[-1].set(xlabel="simulated time, s", xlim=(times_s[0], times_s[-1]))
    return figure_png(figure)
