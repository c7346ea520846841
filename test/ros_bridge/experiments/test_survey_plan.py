"""The grid of a survey."""

from pathlib import Path

import numpy as np
import pytest
from commands import oaisys_here

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import PinholeIntrinsics
from oaisys_ros_bridge.experiments.survey.plan import plan_survey, survey_columns

CAMERA = PinholeIntrinsics(640, 480, 541.14, 541.14, 319.5, 239.5)
STAGE = (-32.0, -32.0, 32.0, 32.0)


def test_thirty_views_are_six_by_five_and_centred() -> None:
    plan = plan_survey(30, 10.0, 0.35, CAMERA, STAGE)
    assert survey_columns(30) == 6
    assert plan.xy_m.shape == (30, 2)
    assert np.allclose(plan.xy_m.mean(axis=0), 0)
    assert plan.xy_m[0, 0] < 0 < plan.xy_m[0, 1], "it begins in the north-west"


def test_neighbours_share_what_was_asked_for() -> None:
    plan = plan_survey(30, 10.0, 0.35, CAMERA, STAGE)
    step_x_m, step_y_m = plan.xy_m[1, 0] - plan.xy_m[0, 0], plan.xy_m[0, 1] - plan.xy_m[6, 1]
    assert step_x_m == pytest.approx(0.65 * 10 * 640 / 541.14)
    assert step_y_m == pytest.approx(0.65 * 10 * 480 / 541.14)


@pytest.mark.parametrize("views", [1, 2, 7, 31])
def test_any_number_of_views_fits(views: int) -> None:
    plan = plan_survey(views, 5.0, 0.5, CAMERA, STAGE)
    assert len(plan.xy_m) == views


@pytest.mark.parametrize(
    ("views", "altitude_m", "overlap", "word"),
    [
        (0, 10, 0.3, "views"),
        (3, 0, 0.3, "altitude"),
        (3, 10, 1.0, "overlap"),
        (30, 40, 0.0, "--altitude of at most 10.82"),
    ],
)
def test_impossible_surveys_are_refused(
    views: int, altitude_m: float, overlap: float, word: str
) -> None:
    with pytest.raises(InvalidInputError, match=word):
        plan_survey(views, altitude_m, overlap, CAMERA, STAGE)


@pytest.mark.parametrize(("altitude_m", "overlap"), [(10.82, 0.0), (40, 0.73)])
def test_what_an_error_proposes_fits(altitude_m: float, overlap: float) -> None:
    assert len(plan_survey(30, altitude_m, overlap, CAMERA, STAGE).xy_m) == 30


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("survey", "--max-range", "0"), "--max-range"),
        (("survey", "--max-range", "-3"), "--max-range"),
        (("survey", "--altitude", "-5"), "--altitude: received -5.0"),
        (("survey", "--altitude", "1e300"), "--altitude: received 1e+300"),
        (("survey", "--overlap", "1"), "--overlap: received 1.0"),
        (("explore", "--start-height", "-5"), "--start-height: received -5.0"),
        (("explore", "--radius", "4"), "--start-height: received 3.0, expected above the vehicle"),
    ],
)
def test_impossible_values_are_refused_before_anything_is_started(
    arguments: tuple[str, ...], expected: str, tmp_path: Path
) -> None:
    """A largest range of 0 was refused by the mapper, with exit code 1 after half a minute."""
    refused = oaisys_here(*arguments, "--out", tmp_path / "out")
    assert refused.returncode == 2, refused.stderr
    assert expected in refused.stderr
    assert not (tmp_path / "out").exists()
