"""Poses that a policy has admitted are admitted again as they are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from synthetic_worlds import SMALL_MATERIALS

from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import check_pose
from oaisys_core.raycast.clearance import admit_pose
from oaisys_core.simulation import Simulation
from oaisys_core.types import Pose

CAMERA: dict[str, Any] = {
    "width_px": 4,
    "height_px": 3,
    "fx_px": 4.0,
    "fy_px": 4.0,
    "modalities": ["depth"],
}


@pytest.fixture(scope="module")
def world() -> Simulation:
    """A world of two cameras that are beside the rig's origin."""
    left = {**CAMERA, "name": "left", "mount_position_m": [0.13, 0.21, 0.07]}
    right = {**CAMERA, "name": "right", "mount_position_m": [0.1, -0.4, 0.3]}
    made = Simulation(
        config_from_mapping(
            {
                "backend": "analytic",
                "stage": {
                    "surroundings": "plain",
                    "preset": "mounds",
                    "extent_m": 40.0,
                    "resolution_px": 65,
                },
                "materials": SMALL_MATERIALS,
                "assets": {"rocks": []},
                "sensors": {"cameras": [left, right]},
            }
        )
    )
    made.step_batch()
    return made


def test_clamped_poses_are_admitted_by_every_policy_as_they_are(world: Simulation) -> None:
    """Rounding left some of them a hair too low, or off the stage, where clamping itself failed."""
    info = world.info()
    assert info.stage_extent_m is not None

    def admitted(pose: Pose, policy: str) -> Pose:
        extent_m = info.stage_extent_m or (0, 0, 0, 0)
        heights = world.query_height
        sensors = info.sensors
        return admit_pose(pose, sensors, heights, extent_m, policy=policy, least_m=0.05)

    rng = np.random.default_rng(0)
    moved = 0
    for quat in rng.normal(size=(300, 4)):
        position_m = np.append(rng.uniform(-60, 60, 2), rng.uniform(-5, 8))
        wanted = check_pose(position_m, quat / np.linalg.norm(quat))
        clamped = admitted(wanted, "clamp")
        moved += clamped != wanted
        assert [admitted(clamped, policy) for policy in ("clamp", "lift", "reject")] == [
            clamped
        ] * 3
    assert moved > 100
