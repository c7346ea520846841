"""What water, rock and wind do on grounds in closed form, and layers that lie by it."""

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from oaisys_core.config.sections.layer_conditions import ConditionConfig
from oaisys_core.procedural.terrain.masks.forces import CELLS, RUN_OUT_M, GroundForces
from oaisys_core.scene import HeightField
from oaisys_core.world.modules.layer_gates import gate_of_level, layer_gates

EDGE_M = 96.0
SPACING_M = 0.25
"""Two samples a cell of the maps lie a cell apart, so that heights are those of the formula."""

AXIS_M = (np.arange(int(EDGE_M / SPACING_M) + 1) * SPACING_M) - EDGE_M / 2
X_M, Y_M = np.meshgrid(AXIS_M, AXIS_M)
CENTRES_M = (np.arange(CELLS) + 0.5) * EDGE_M / CELLS - EDGE_M / 2


def ground(elevation_m: NDArray[np.float64]) -> HeightField:
    return HeightField(elevation_m.astype(np.float32), (-EDGE_M / 2, -EDGE_M / 2), SPACING_M)


def valley() -> HeightField:
    """A V along y that falls towards -y."""
    return ground(0.5 * np.abs(X_M) + 0.05 * Y_M)


def cliff() -> HeightField:
    """A wall of 60 degrees, 20 m high, whose foot is at x = 0, between two levels.

    The levels fall towards +x by 1 %, so that it is known where everything goes.
    """
    rise_m = np.clip(-X_M, 0, 20 / np.tan(np.radians(60))) * np.tan(np.radians(60))
    return ground(rise_m - 0.01 * X_M)


def test_water_gathers_in_the_valley_and_grows_along_it() -> None:
    flow = GroundForces(valley()).flow_share
    inner = slice(CELLS // 4, 3 * CELLS // 4)
    assert np.abs(CENTRES_M[flow[inner].argmax(axis=1)]).max() < 1.0
    bottom = flow[:, CELLS // 2 - 2 : CELLS // 2 + 2].max(axis=1)
    assert bottom[CELLS // 4] > bottom[3 * CELLS // 4] > 0.98
    assert np.median(flow[inner, [30, -30]]) < 0.5


def test_rock_comes_to_rest_below_the_wall_and_less_with_distance() -> None:
    debris = GroundForces(cliff()).debris_share
    profile = np.median(debris, axis=0)
    assert profile[CENTRES_M < -15].max() == 0, "nothing falls on what stands above the wall"
    at = {m: profile[np.abs(CENTRES_M - m).argmin()] for m in (3.0, 8.0, 15.0, 25.0)}
    assert at[3.0] > at[8.0] > at[15.0] > at[25.0] > 0
    on_wall = profile[(CENTRES_M > -8) & (CENTRES_M < -3)]
    assert on_wall.max() < at[25.0], "it slides past what is steeper than its angle of repose"


def test_rock_that_rests_falls_off_as_the_run_out_says() -> None:
    """Of what passes level ground, 1/e is left after the run-out's distance."""
    forces = GroundForces(cliff())
    (rest,) = [forces._resting(flow).mean(axis=0) for flow in forces._flows[:1]]
    cell_m = EDGE_M / CELLS
    first, last = (int(np.abs(CENTRES_M - m).argmin()) for m in (4.0, 4.0 + RUN_OUT_M))
    levelness = 1 - 0.01 / np.tan(np.radians(34))
    assert rest[last : last + 8].sum() / rest[first : first + 8].sum() == pytest.approx(
        np.exp(-levelness * (last - first) * cell_m / RUN_OUT_M), rel=0.1
    )


@pytest.mark.parametrize("wind_from_deg", [0.0, 90.0, 180.0, 270.0])
def test_shelter_is_the_angle_to_the_brink_upwind(wind_from_deg: float) -> None:
    azimuth = np.radians(wind_from_deg)
    upwind_m = X_M * np.sin(azimuth) + Y_M * np.cos(azimuth)
    # A plateau 6 m high begins 10 m upwind of the centre; its wall is 0.25 m wide.
    step = ground(6.0 * (upwind_m > 10.0))
    shelter_deg = GroundForces(step).shelter_deg(wind_from_deg)
    for distance_m in (4.0, 10.0, 20.0):
        x_m, y_m = (10.0 - distance_m) * np.array([np.sin(azimuth), np.cos(azimuth)])
        column, row = (int(np.abs(CENTRES_M - at).argmin()) for at in (x_m, y_m))
        # Distances are compared in steps of 12 %.
        expected_deg = np.degrees(np.arctan(6.0 / distance_m))
        assert 0.86 * expected_deg < shelter_deg[row, column] < 1.06 * expected_deg
    brink = [int(np.abs(CENTRES_M - 14.0 * d).argmin()) for d in (np.sin(azimuth), np.cos(azimuth))]
    assert shelter_deg[brink[1], brink[0]] == pytest.approx(0, abs=1e-6)


def test_crests_and_hollows_are_at_the_ends_of_the_scale() -> None:
    waves = GroundForces(ground(np.cos(2 * np.pi * X_M / 12)))
    crest = np.median(waves.crest_share(6.0), axis=0)
    inside = np.abs(CENTRES_M) < 36
    crests, hollows = (inside & (np.abs((CENTRES_M - at + 6) % 12 - 6) < 0.4) for at in (0.0, 6.0))
    assert crest[crests].min() > 0.85
    assert crest[hollows].max() < 0.15


def test_layers_lie_where_their_conditions_hold() -> None:
    size_px = 256
    x_m = (np.arange(size_px) + 0.5) * EDGE_M / size_px - EDGE_M / 2
    wet = ConditionConfig(flow_share=(0.97, 1.0), soft_share=0.0)
    gates = layer_gates([None, wet], valley(), size_px)
    assert gates is not None
    assert (gates[0] == 1).all()
    # Rills that come together by chance are few.
    assert (gates[1][:, np.abs(x_m) > 10] > 0).mean() < 0.02
    bottom = gates[1][: size_px // 2, np.abs(x_m) < 1.5]
    assert (bottom.max(axis=1) == 1).mean() > 0.95
    talus = layer_gates([None, ConditionConfig(debris_share=(0.6, 1.0))], cliff(), size_px)
    assert talus is not None
    assert talus[1][:, x_m < -15].max() == 0
    assert np.median(talus[1][:, (x_m > 2) & (x_m < 6)]) == 1


def test_a_plain_has_neither_channels_nor_debris_nor_shelter() -> None:
    for when, expected in (
        ({"flow_share": (0.9, 1)}, 0),
        ({"flow_share": (0, 0.9)}, 1),
        ({"debris_share": (0.1, 1)}, 0),
        ({"debris_share": (0, 0.3)}, 1),
        ({"crest_share": (0.8, 1)}, 0),
        ({"shelter_deg": (10, 90)}, 0),
        ({"shelter_deg": (-20, 20)}, 1),
    ):
        assert gate_of_level(ConditionConfig.model_validate(when)) == expected


def test_bounds_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(ValidationError, match=r"flow_share: received \[0.9, 0.1\]"):
        ConditionConfig(flow_share=(0.9, 0.1))
