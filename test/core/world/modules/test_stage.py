"""Stages from files, refined stages, and stages that are reused, as a whole simulation has them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from matplotlib.tri import LinearTriInterpolator, Triangulation
from synthetic_worlds import SMALL_MATERIALS

from oaisys_core import geometry
from oaisys_core.config import config_from_mapping
from oaisys_core.errors import ConfigError, InvalidInputError, NotReadyError
from oaisys_core.output import exr
from oaisys_core.procedural.meshes.loaded import LoadedMesh
from oaisys_core.procedural.terrain.mesh_ground import MeshGround, mesh_ground
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata
from oaisys_core.world.stage_store import load_stage

LOOK = geometry.pose_looking_down(1.0, 2.0, 12.0)


def simulation(stage: dict[str, Any], **more: Any) -> Simulation:
    small: dict[str, Any] = {
        "backend": "analytic",
        "materials": {
            "layers": [{"texture": "sand", "label": "sand", "semantic_id": 1}],
            **SMALL_MATERIALS,
        },
        "assets": {
            "rocks": [{"count": [20, 30], "variants": 2, "label": "rock", "semantic_id": 2}]
        },
        "sensors": {
            "cameras": [
                {
                    "name": "front",
                    "width_px": 48,
                    "height_px": 36,
                    "modalities": ["depth", "semantic_0", "instance"],
                }
            ]
        },
    }
    return Simulation(config_from_mapping({**small, "stage": stage, **more}))


def stage_metadata(**stage: Any) -> ModuleMetadata:
    return ModuleMetadata(custom={"stage": stage})


def rocks(world: Simulation) -> list[bytes]:
    return [p.T_map_object.tobytes() + p.instance_ids.tobytes() for p in world.scene.placements]


def ground_bytes(world: Simulation) -> bytes:
    ground = world.scene.ground
    return ground.vertices_m().tobytes() + ground.triangles().tobytes()


def views(world: Simulation, pose: Any = LOOK) -> list[bytes]:
    sample = world.step_sample(ModuleMetadata(sensor={"pose": pose}))
    return [frame.data.tobytes() for frame in sample.frames]


def cone(rings: int = 64) -> LoadedMesh:
    angle = np.linspace(0, 2 * np.pi, rings, endpoint=False)
    rim = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(rings)))
    vertices = np.vstack((rim, [(0, 0, 0.5)])).astype(np.float32)
    index = np.arange(rings)
    triangles = np.column_stack((index, np.roll(index, -1), np.full(rings, rings)))
    return LoadedMesh("cone", vertices, triangles.astype(np.int32))


def test_a_mesh_is_a_ground() -> None:
    ground = mesh_ground(cone(), scale=20.0, up="z", position_m=(5.0, 0.0, 1.0))
    assert ground.extent_m == pytest.approx((-15, -20, 25, 20))
    xy = np.random.default_rng(1).uniform(-12, 12, (500, 2))
    expected = 1 + 10 - 0.5 * np.linalg.norm(xy, axis=1)
    assert ground.height_at(xy + np.array((5.0, 0.0))) == pytest.approx(expected, abs=0.02)
    assert np.isnan(ground.height_at([(24.0, 19.0)])).all()
    assert 0.5 < ground.spacing_m < 10.0


@pytest.mark.parametrize(("up", "column"), [("x", 0), ("y", 1), ("z", 2)])
def test_an_axis_points_up_and_triangles_face_up(up: str, column: int) -> None:
    order = (column + np.array((1, 2, 0))) % 3
    turned = np.empty_like(cone().vertices_m)
    turned[:, order] = cone().vertices_m
    flipped = LoadedMesh("cone", turned, np.ascontiguousarray(cone().triangles[:, ::-1]))
    ground = mesh_ground(flipped, scale=1.0, up=up, position_m=(0.0, 0.0, 0.0))
    assert ground.height_at([(0.0, 0.0)]) == pytest.approx([0.5])
    a, b, c = (ground.vertices_m()[ground.triangles()[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".glb"])
def test_a_file_is_the_stage(tmp_path: Path, suffix: str) -> None:
    mesh = cone()
    vertices = mesh.vertices_m.astype(float)
    if suffix == ".glb":
        vertices = np.column_stack((vertices[:, 0], vertices[:, 2], -vertices[:, 1]))
    trimesh.Trimesh(vertices, mesh.triangles, process=False).export(tmp_path / f"cone{suffix}")
    stage = {"mesh": {"file": str(tmp_path / f"cone{suffix}"), "scale": 30.0}}
    world = simulation(stage)
    world.step_batch()
    assert isinstance(world.scene.ground, MeshGround)
    sample = world.step_sample(
        ModuleMetadata(sensor={"pose": geometry.pose_looking_down(0.0, 0.0, 40.0)})
    )
    depth_m = sample.frames[0].data
    labels = sample.frames[1].data
    assert depth_m[labels == 1].min() == pytest.approx(25.0, abs=0.3)
    assert world.query_height([(10.0, 0.0, 0.0)]).ground_height_m[0] == pytest.approx(
        10.0, abs=0.05
    )
    assert rocks(world), "things stand on it"


def test_relief_from_a_file_is_the_stage_and_says_what_was_filled(tmp_path: Path) -> None:
    heights = np.full((33, 33), 2.0, np.float32)
    heights[10:12, 10:12] = np.nan
    exr.write_channels(tmp_path / "flat.exr", {exr.GREY: heights})
    world = simulation({"dem": {"file": str(tmp_path / "flat.exr"), "spacing_m": 1.0}})
    world.step_batch()
    notes = world.scene.custom["stage"]
    assert (notes["holes"], notes["filled_px"]) == (1, 4)
    assert world.scene.ground.height_at([(3.3, -2.2)]) == pytest.approx([0.0])


@pytest.mark.parametrize(
    "stage",
    [
        {"dem": {"file": "nowhere.tif"}},
        {"mesh": {"file": "nowhere.obj"}},
        {"reuse": {"objects": "keep"}},
        {"reuse": {"name": "../stage"}},
        {"save_as": "hill"},
        {"preset": "ocean"},
    ],
)
def test_what_does_not_fit_is_refused(stage: dict[str, Any]) -> None:
    with pytest.raises(ConfigError):
        simulation(stage)


SMALL = {"preset": "mounds", "extent_m": 40.0, "resolution_px": 65, "surroundings": "plain"}


def test_metadata_chooses_the_stage_of_a_batch() -> None:
    world = simulation(SMALL)
    world.step_batch(stage_metadata(preset="plane"))
    assert (world.scene.ground.vertices_m()[:, 2] == 0).all()
    world.step_batch()
    assert np.ptp(world.scene.ground.vertices_m()[:, 2]) > 1
    for wrong in ({"preset": "ocean"}, {"extend_m": 3}, {"store": "elsewhere"}):
        with pytest.raises(InvalidInputError):
            world.step_batch(stage_metadata(**wrong))
    with pytest.raises(InvalidInputError):
        world.step_sample(stage_metadata(preset="plane"))


def test_equal_seeds_with_other_metadata_give_other_stages() -> None:
    world = simulation(SMALL)
    world.step_batch(seed=5)
    first = ground_bytes(world)
    world.step_batch(stage_metadata(relief_m=9.0), seed=5)
    assert ground_bytes(world) != first


def test_all_see_the_same_refined_surface() -> None:
    detail = {"radius_m": 3.0, "spacing_m": 0.05}
    world = simulation({**SMALL, "detail": detail}, assets={"rocks": []})
    world.step_batch()
    coarse = ground_bytes(world)
    z = 2.5 + world.query_height([(1.0, 2.0, 0.0)]).surface_height_m[0]
    low = geometry.pose_looking_down(1.0, 2.0, z)
    first = views(world, low)
    assert ground_bytes(world) != coarse

    mesh = world.ground_truth_mesh()
    x, y, height_m = mesh.vertices_m.T
    surface = LinearTriInterpolator(Triangulation(x, y, mesh.triangles), height_m)
    xy = np.random.default_rng(1).uniform((-3, -2), (5, 6), (500, 2))
    heights = world.query_height(np.column_stack((xy, np.zeros(len(xy)))))
    expected = surface(*xy.T).filled(np.nan)
    assert heights.ground_height_m == pytest.approx(expected, abs=1e-5)
    assert heights.surface_height_m == pytest.approx(expected, abs=1e-5)

    frame = world.step_sample(ModuleMetadata(sensor={"pose": low})).frames[0]
    v, u = np.mgrid[: frame.data.shape[0], : frame.data.shape[1]]
    k = frame.intrinsics
    rays = np.stack(((u - k.cx_px) / k.fx_px, (v - k.cy_px) / k.fy_px, np.ones(u.shape)), axis=-1)
    points = rays * frame.data[..., None] @ frame.T_map_camera[:3, :3].T + frame.T_map_camera[:3, 3]
    seen = surface(points[..., 0], points[..., 1]).filled(np.nan)
    assert points[..., 2] == pytest.approx(seen, abs=1e-5)

    views(world, geometry.pose_looking_down(-12.0, 8.0, 12.0))
    assert views(world, low) == first, "a pose has one view, wherever the rig was before"


def test_a_refined_world_is_restored(tmp_path: Path) -> None:
    stage = {**SMALL, "detail": {"radius_m": 3.0, "spacing_m": 0.1}}
    world, other = simulation(stage), simulation(stage)
    world.step_batch()
    views(world)
    other.restore(world.state())
    assert ground_bytes(other) == ground_bytes(world)
    later = geometry.pose_looking_down(3.0, 2.0, 10.0)
    assert views(other, later) == views(world, later)
    world.step_batch(reuse_stage=True)
    assert views(world, later)[0] != b""


def test_the_standing_stage_is_reused_by_its_hash() -> None:
    world = simulation(SMALL)
    world.step_batch(stage_metadata(relief_m=9.0))
    ground, things = ground_bytes(world), rocks(world)
    stage_hash = world.scene.custom["stage"]["hash"]

    world.step_batch(stage_metadata(reuse={"name": stage_hash, "objects": "keep"}))
    assert (ground_bytes(world), rocks(world)) == (ground, things)
    world.step_batch(stage_metadata(reuse={"name": stage_hash}))
    assert ground_bytes(world) == ground
    assert rocks(world) != things
    world.step_batch(stage_metadata(reuse={"name": stage_hash, "objects": "clear"}))
    assert ground_bytes(world) == ground
    assert sum(len(p.instance_ids) for p in world.scene.placements) == 0

    other = simulation(SMALL)
    other.restore(world.state())
    assert (ground_bytes(other), rocks(other)) == (ground, rocks(world))
    world.step_batch(reuse_stage=True)
    other.restore(world.state())
    assert (ground_bytes(other), rocks(other)) == (ground, rocks(world))


def test_a_stage_outlives_its_run(tmp_path: Path) -> None:
    stage = {**SMALL, "store": str(tmp_path / "stages")}
    world = simulation(stage)
    world.step_batch(stage_metadata(save_as="hill", relief_m=9.0))
    ground, things = ground_bytes(world), rocks(world)
    stage_hash = world.scene.custom["stage"]["hash"]
    masks = world.scene.material.masks.tobytes()
    world.step_batch()

    for name in (stage_hash, "hill"):
        later = simulation({**stage, "preset": "plane"}, seed=77)
        later.step_batch()
        later.step_batch(stage_metadata(reuse={"name": name, "objects": "keep"}))
        assert (ground_bytes(later), rocks(later)) == (ground, things)
        assert later.scene.material.masks.tobytes() == masks
        material = later.scene.material
        later.step_batch(stage_metadata(reuse={"name": name, "objects": "redraw"}))
        assert ground_bytes(later) == ground
        assert rocks(later) != things
        again = simulation({**stage, "preset": "plane"}, seed=77)
        again.restore(later.state())
        assert (ground_bytes(again), rocks(again)) == (ground, rocks(later))
        assert material is not None

    file = str(tmp_path / "stages" / "hill.npz")
    always = simulation({**SMALL, "reuse": {"file": file, "objects": "keep"}}, seed=78)
    for _ in range(2):
        always.step_batch()
        assert (ground_bytes(always), rocks(always)) == (ground, things)


def test_a_mesh_is_kept_as_well(tmp_path: Path) -> None:
    mesh = cone()
    trimesh.Trimesh(mesh.vertices_m, mesh.triangles, process=False).export(tmp_path / "cone.ply")
    store = str(tmp_path / "stages")
    world = simulation(
        {"mesh": {"file": str(tmp_path / "cone.ply"), "scale": 30.0}, "store": store}
    )
    world.step_batch(stage_metadata(save_as="cone"))
    later = simulation({**SMALL, "store": store, "reuse": {"name": "cone"}})
    later.step_batch()
    assert ground_bytes(later) == ground_bytes(world)


def test_stages_that_cannot_be_reused_are_refused(tmp_path: Path) -> None:
    stage = {**SMALL, "store": str(tmp_path)}
    world = simulation(stage)
    with pytest.raises(NotReadyError):
        world.step_batch(reuse_stage=True)
    world.step_batch(stage_metadata(save_as="hill"))
    ground = ground_bytes(world)
    for reuse in ({"name": "dale"}, {"name": "../hill"}, {"file": "/nowhere.npz"}, {}):
        with pytest.raises(InvalidInputError):
            world.step_batch(stage_metadata(reuse=reuse))
    assert ground_bytes(world) == ground, "the world that stands is kept"

    others = {"assets": {"rocks": [{"count": [5, 6], "label": "rock", "semantic_id": 2}]}}
    with pytest.raises(InvalidInputError, match="another asset configuration"):
        simulation(stage, **others).step_batch(
            stage_metadata(reuse={"name": "hill", "objects": "keep"})
        )

    damaged = dict(np.load(tmp_path / "hill.npz"))
    damaged["elevation_m"] = damaged["elevation_m"] + np.float32(1)
    np.savez(tmp_path / "damaged.npz", **damaged)
    (tmp_path / "text.npz").write_text("no stage")
    for name in ("damaged", "text"):
        with pytest.raises(InvalidInputError, match=name):
            load_stage(tmp_path / f"{name}.npz")
