"""Where meshes from files are placed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from synthetic_worlds import SMALL_MATERIALS

from oaisys_core.config import config_from_mapping
from oaisys_core.simulation import Simulation

POSITION_M = (2.0, -1.0, 5.0)


def corners_m(path: Path, **more: Any) -> tuple[list[float], list[float]]:
    """The bounding box in ``map`` of a mesh that is placed at `POSITION_M`."""
    label = {"label": "thing", "semantic_id": 7}
    thing = {"name": "thing", "file": str(path), "position_m": POSITION_M, **label, **more}
    config = {
        "backend": "analytic",
        "stage": {"preset": "plane", "extent_m": 20.0, "resolution_px": 17},
        "materials": SMALL_MATERIALS,
        "assets": {"rocks": [], "objects": [thing]},
    }
    simulation = Simulation(config_from_mapping(config))
    simulation.step_batch()
    mesh = simulation.ground_truth_mesh()
    assert mesh.semantic_ids is not None
    points = mesh.vertices_m[mesh.triangles[mesh.semantic_ids == 7]].reshape(-1, 3)
    return points.min(axis=0).tolist(), points.max(axis=0).tolist()


@pytest.fixture
def block(tmp_path: Path) -> Path:
    """A box of 1 x 2 x 3 m, whose middle is at (4, 0, 1) of the file."""
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    box.vertices += (4.0, 0.0, 1.0)
    box.export(tmp_path / "block.obj")
    return tmp_path / "block.obj"


def test_an_object_stands_on_the_centre_of_its_base(block: Path) -> None:
    low, high = corners_m(block)
    np.testing.assert_allclose(low, (1.5, -2.0, 5.0), atol=1e-6)
    np.testing.assert_allclose(high, (2.5, 0.0, 8.0), atol=1e-6)


def test_or_on_the_origin_of_its_file(block: Path) -> None:
    low, high = corners_m(block, anchor="origin")
    np.testing.assert_allclose(low, (5.5, -2.0, 4.5), atol=1e-6)
    np.testing.assert_allclose(high, (6.5, 0.0, 7.5), atol=1e-6)


def test_an_obj_file_that_is_y_up_is_turned_by_its_key(block: Path) -> None:
    low, high = corners_m(block, up_axis="y", scale=2.0)
    np.testing.assert_allclose(np.subtract(high, low), (2.0, 6.0, 4.0), atol=1e-6)
    assert low[2] == pytest.approx(POSITION_M[2])
