"""A refined stage in Blender: what it renders is what all queries are answered from."""

from __future__ import annotations

import numpy as np
import pytest
from blender_process import in_blender

pytestmark = pytest.mark.blender

STAGE = {
    "preset": "mounds",
    "extent_m": 40.0,
    "resolution_px": 81,
    "detail": {"radius_m": 3.0, "spacing_m": 0.1, "amplitude_m": 0.05},
}
NEAR, FAR = (1.0, 2.0), (-9.0, 6.0)


def test_the_refined_ground_is_rendered_as_it_is_measured() -> None:
    found = in_blender("stage.refined_views", STAGE, [NEAR, FAR, NEAR])
    for points, ground_m in zip(found["surface"], found["ground"], strict=True):
        assert points[:, 2] == pytest.approx(ground_m, abs=1e-4)
    assert found["depth"][0].tobytes() == found["depth"][2].tobytes()
    assert found["depth"][0].tobytes() != found["depth"][1].tobytes()
    assert found["mesh"] == found["scene"]
    assert np.isfinite(found["depth"][0]).all(), "no gap along the seam"
    assert np.ptp(found["rgb"][0].astype(float)) > 10
    assert found["corner_normals"] == pytest.approx(found["normals"], abs=1e-3)
