"""Stages in files of somebody else: whatever their hash says, they are checked as new ones are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic_worlds import SMALL_MATERIALS

from oaisys_core.config import config_from_mapping
from oaisys_core.config.sections.stage import MAX_PX
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.terrain.mesh_ground import MeshGround
from oaisys_core.scene import Ground, HeightField
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata
from oaisys_core.world.reuse import assets_sha256
from oaisys_core.world.stage_store import StageRecord, content_hash, load_stage, save_stage

HEIGHTS = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)
GRID = HeightField(HEIGHTS, (-1.0, -2.0), 0.5)
POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 0]], np.float32)
CORNERS = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
UPRIGHT = np.array([[0, 0, 0], [1, 1, 0], [1, 1, 1]], np.float32)
ONE = CORNERS[:1]
SMALL: dict[str, Any] = {
    "backend": "analytic",
    "materials": {
        "layers": [{"texture": "sand", "label": "sand", "semantic_id": 1}],
        **SMALL_MATERIALS,
    },
    "sensors": {"cameras": [{"name": "front", "width_px": 8, "height_px": 6}]},
}


def record_of(ground: Ground, **fields: Any) -> StageRecord:
    known = {"stage_seed": 2**63 - 1, "asset_seed": 0, "assets_sha256": "0" * 64}
    return StageRecord(content_hash(ground), ground, **{**known, **fields})


def changed(value: float) -> HeightField:
    heights = HEIGHTS.copy()
    heights[1, 2] = value
    return HeightField(heights, GRID.origin_xy_m, GRID.spacing_m)


def grid_of(heights: Any) -> HeightField:
    return HeightField(heights, (0.0, 0.0), 1.0)


def refusal(path: Path) -> str:
    with pytest.raises(InvalidInputError) as refused:
        load_stage(path)
    text = str(refused.value)
    assert text.startswith("stage.reuse.file")
    assert path.name in text
    assert len(text) < 400
    return text


def test_a_stage_without_objects_has_no_hash_of_them(tmp_path: Path) -> None:
    save_stage(tmp_path / "stage.npz", record_of(GRID, assets_sha256=""))
    assert load_stage(tmp_path / "stage.npz").assets_sha256 == ""


@pytest.mark.parametrize("ground", [GRID, MeshGround(POINTS, CORNERS)])
def test_what_was_stored_comes_back(ground: HeightField | MeshGround, tmp_path: Path) -> None:
    record = record_of(ground, asset_metadata={"count_factor": 0.5})
    save_stage(tmp_path / "stage.npz", record)
    found = load_stage(tmp_path / "stage.npz")
    assert content_hash(found.ground) == record.stage_hash
    assert found.stage_seed == 2**63 - 1
    assert found.asset_metadata == {"count_factor": 0.5}


@pytest.mark.parametrize(
    ("ground", "expected"),
    [
        (changed(np.nan), "finite heights"),
        (changed(-np.inf), "finite heights"),
        (changed(1.1e7), "heights of at most 1e.07 m"),
        (grid_of(HEIGHTS.astype(np.float64)), "float32 heights in rows and columns, not float64"),
        (grid_of(HEIGHTS.astype(np.int64)), "not int64"),
        (grid_of(HEIGHTS.astype(np.complex64)), "not complex64"),
        (grid_of(HEIGHTS.astype("U8")), "not <U8"),
        (grid_of(HEIGHTS[:1]), r"points along an edge, not \(1, 4\)"),
        (grid_of(HEIGHTS[:, :0]), r"points along an edge, not \(3, 0\)"),
        (grid_of(np.zeros((2, MAX_PX + 1), np.float32)), rf"2 to {MAX_PX} points along an edge"),
        (HeightField(HEIGHTS, (0.0, 0.0), 0.0), "a spacing above 0 m, not 0 m"),
        (HeightField(HEIGHTS, (0.0, 0.0), -1.0), "a spacing above 0 m, not -1 m"),
        (HeightField(HEIGHTS, (0.0, 0.0), np.nan), "a spacing above 0 m, not nan m"),
        (HeightField(HEIGHTS, (np.nan, 0.0), 1.0), "a ground within 2e.07 m"),
        (HeightField(HEIGHTS, (0.0, 1e12), 1.0), "a ground within 2e.07 m"),
        (HeightField(HEIGHTS, (0.0, 0.0), 1e-9), "a ground of 0.01 to 1e.07 m in x and in y"),
        (HeightField(HEIGHTS, (0.0, 0.0), 6e6), "a ground of 0.01 to 1e.07 m in x and in y"),
        (MeshGround(POINTS.astype(np.float64), CORNERS), "float32 vertices"),
        (MeshGround(POINTS[:, :2], CORNERS), r"three coordinates, not float32 \(4, 2\)"),
        (MeshGround(POINTS.ravel(), CORNERS), r"three coordinates, not float32 \(12,\)"),
        (MeshGround(POINTS, CORNERS.astype(np.float64)), "int32 triangles"),
        (MeshGround(POINTS, CORNERS.T), r"three indices, not int32 \(3, 2\)"),
        (MeshGround(POINTS, CORNERS[:0]), "at least one triangle"),
        (MeshGround(POINTS, CORNERS + 7), "triangle indices below 4"),
        (MeshGround(POINTS, CORNERS - 1), "triangle indices below 4"),
        (MeshGround(POINTS * np.float32(np.nan), CORNERS), "finite coordinates"),
        (MeshGround(POINTS * np.float32(1e8), CORNERS), "finite coordinates of at most 1e.07"),
        (MeshGround(POINTS * np.float32(1e-4), CORNERS), "a ground of 0.01 to 1e.07 m"),
        (MeshGround(UPRIGHT, ONE), "vertical ones have no ground"),
        (MeshGround(POINTS[[0, 0, 0]], ONE), "at least one triangle with an area"),
    ],
)
def test_a_ground_that_no_new_stage_has_is_refused(
    ground: HeightField | MeshGround, expected: str, tmp_path: Path
) -> None:
    path = tmp_path / "stage.npz"
    save_stage(path, record_of(ground))
    with pytest.raises(InvalidInputError, match=expected):
        load_stage(path)
    refusal(path)


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("stage_seed", "-1", "received '-1', expected a whole number from 0 to 2"),
        ("stage_seed", str(2**63), "from 0 to 2"),
        ("stage_seed", "٣", "from 0 to 2"),
        ("stage_seed", "9" * 100_000, "from 0 to 2"),
        ("asset_seed", 1.5, "received 1.5, expected text"),
        ("asset_seed", None, "received None, expected text"),
        ("format", 2, "received 2, expected a stage of format 1"),
        ("format", True, "received True, expected a whole number"),
        ("hash", "../../x", "expected text that matches"),
        ("assets_sha256", 5, "received 5, expected text"),
        ("asset_metadata", [1], "expected a mapping"),
        ("unknown", 1, "expected"),
    ],
)
def test_a_record_is_refused_by_its_field(
    field: str, value: object, expected: str, tmp_path: Path
) -> None:
    path = tmp_path / "stage.npz"
    save_stage(path, record_of(GRID))
    arrays = dict(np.load(path))
    record = {**json.loads(str(arrays["record"])), field: value}
    np.savez(path, **{**arrays, "record": np.array(json.dumps(record))})
    text = refusal(path)
    assert f"stage.npz: {field}" in text
    assert expected in text


@pytest.mark.parametrize(
    ("name", "array", "expected"),
    [
        ("record", None, "it has no record"),
        ("elevation_m", None, "it has no points_m"),
        ("grid", None, "it has no grid"),
        ("grid", np.zeros(4), "its grid is float64 (4,)"),
        ("record", np.zeros(3, np.uint8), "its record is uint8 (3,)"),
        ("record", np.array("{"), "Expecting"),
    ],
)
def test_arrays_that_are_missing_or_others_are_named(
    name: str, array: Any, expected: str, tmp_path: Path
) -> None:
    path = tmp_path / "stage.npz"
    save_stage(path, record_of(GRID))
    arrays = {**np.load(path), name: array}
    np.savez(path, **{key: each for key, each in arrays.items() if each is not None})
    assert expected in refusal(path)


def test_kept_metadata_of_objects_is_checked_as_that_of_a_request(tmp_path: Path) -> None:
    config = config_from_mapping(SMALL)
    record = record_of(
        HeightField(np.zeros((9, 9), np.float32), (-2.0, -2.0), 0.5),
        assets_sha256=assets_sha256(config),
        asset_metadata={"groups": {"trees": {"count_factor": 2}}},
    )
    save_stage(tmp_path / "stage.npz", record)
    world = Simulation(config)
    reuse = {"file": str(tmp_path / "stage.npz"), "objects": "keep"}
    with pytest.raises(InvalidInputError, match=r"stage\.reuse\.file.*groups\.trees"):
        world.step_batch(ModuleMetadata(custom={"stage": {"reuse": reuse}}))
    with pytest.raises(InvalidInputError, match=r"metadata\.asset\.groups\.trees"):
        world.step_batch(ModuleMetadata(asset=record.asset_metadata))
