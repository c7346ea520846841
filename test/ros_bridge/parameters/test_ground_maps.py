"""Maps of the ground that would take too long are refused by the parameter's name."""

from __future__ import annotations

from typing import Any

import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.parameters.ground_maps import check_ground_map
from oaisys_ros_bridge.parameters.mapper import MAPPER

DEFAULTS = {row.name: row.default for row in MAPPER}


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        (
            {"ground_map.length_m": 300.0},
            "ground_map.resolution_m: received 0.2, expected at least 0.3 m",
        ),
        (
            {"ground_map.radius_m": 9.0},
            "ground_map.radius_m: received 9.0, expected at most 20 cells, 4 m",
        ),
    ],
)
def test_too_many_cells_are_refused(changes: dict[str, Any], reason: str) -> None:
    check_ground_map(DEFAULTS)
    with pytest.raises(InvalidInputError) as caught:
        check_ground_map({**DEFAULTS, **changes})
    assert str(caught.value).startswith(reason)
