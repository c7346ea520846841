"""The options of a survey, and its grid of viewpoints that look straight down."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import MAX_M, nadir_spacing_m
from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_ros_bridge.experiments.configuration import ExperimentOptions


@dataclass(frozen=True)
class SurveyOptions(ExperimentOptions):
    """Options of a survey.

    Attributes:
        views: Viewpoints on the grid.
        altitude_m: Height above the surface below each.
        overlap: Share of an image's edge that neighbours share.
        faults: Whether to run the perturbation test.
    """

    views: int
    altitude_m: float
    overlap: float
    faults: bool = True


NORTH_UP_YAW_RAD = pi / 2
"""Yaw of a rig that looks down and has +y at the upper edge of its image."""


@dataclass(frozen=True)
class SurveyPlan:
    """A grid of nadir viewpoints, row by row from the north-west.

    Attributes:
        xy_m: (N, 2) positions in ``map``.
        altitude_m: Height above the surface right below.
    """

    xy_m: FloatArray
    altitude_m: float


def survey_columns(views: int) -> int:
    """Return the number of columns of a grid: thirty viewpoints are six by five."""
    return ceil(sqrt(views * 6 / 5))


def check_grid(views: int, altitude_m: float, overlap: float) -> None:
    """Raise `InvalidInputError` where no grid has these values."""
    if views < 1:
        raise InvalidInputError("--views", views, "at least 1")
    if not 0 < altitude_m <= MAX_M:
        raise InvalidInputError("--altitude", altitude_m, f"metres above 0, at most {MAX_M:g}")
    if not 0 <= overlap < 1:
        raise InvalidInputError("--overlap", overlap, "a share from 0 to below 1")


def plan_survey(
    views: int,
    altitude_m: float,
    overlap: float,
    intrinsics: PinholeIntrinsics,
    extent_m: tuple[float, float, float, float],
) -> SurveyPlan:
    """Return viewpoints around the stage's centre whose images overlap by ``overlap``.

    Args:
        views: How many.
        altitude_m: Height above the surface below each.
        overlap: Share of an image's edge that neighbours share, on flat ground.
        intrinsics: The camera that looks down.
        extent_m: (min_x, min_y, max_x, max_y) of the stage.

    Raises:
        InvalidInputError: A value is out of range, or the grid is larger than the stage.
    """
    check_grid(views, altitude_m, overlap)
    columns = survey_columns(views)
    rows = ceil(views / columns)
    step_x_m, step_y_m = nadir_spacing_m(altitude_m, overlap, intrinsics)
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    x = (column - (columns - 1) / 2) * step_x_m
    y = ((rows - 1) / 2 - row) * step_y_m
    low, high = np.array(extent_m[:2]), np.array(extent_m[2:])
    xy_m = np.column_stack((x.ravel(), y.ravel()))[:views] + (low + high) / 2
    if ((xy_m < low) | (xy_m > high)).any():
        step_m = np.array((step_x_m, step_y_m))
        raise _too_large(np.array((columns, rows)), step_m, high - low, altitude_m, overlap)
    return SurveyPlan(xy_m, altitude_m)


def _too_large(
    grid: NDArray[np.intp],
    step_m: FloatArray,
    stage_m: FloatArray,
    altitude_m: float,
    overlap: float,
) -> InvalidInputError:
    """Return the error of a grid that is larger than the stage; it says what would fit."""
    span_m = (grid - 1) * step_m
    shrink = float((stage_m[grid > 1] / span_m[grid > 1]).min())
    fitting = (stage_m / step_m).astype(int) + 1
    received = (
        f"{grid[0]} x {grid[1]} views {step_m[0]:.1f} m and {step_m[1]:.1f} m apart: "
        f"{span_m[0]:.1f} m x {span_m[1]:.1f} m"
    )
    expected = (
        f"viewpoints on the stage of {stage_m[0]:g} m x {stage_m[1]:g} m: --altitude of at most "
        f"{_floor(altitude_m * shrink):g}, --overlap of at least "
        f"{_ceiling(1 - (1 - overlap) * shrink):g}, or --views for at most "
        f"{fitting[0]} x {fitting[1]}"
    )
    return InvalidInputError("the survey's grid", received, expected)


def _floor(value: float) -> float:
    return floor(100 * value) / 100


def _ceiling(value: float) -> float:
    return ceil(100 * value) / 100
