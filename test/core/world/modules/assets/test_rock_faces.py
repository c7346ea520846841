"""Worlds with broken rock in their walls: where it is seen, and what it is part of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import pytest
from covered_worlds import cover, covered_world, poses

from oaisys_core.geometry import pixel_rays, pose_looking_at
from oaisys_core.simulation import Simulation
from oaisys_core.types import FloatArray, Frame, ModuleMetadata, ObjectQuery

ROCK: dict[str, Any] = {"texture": "bedrock", "label": "rock", "semantic_id": 3}
STAGE = {"preset": "mesa", "extent_m": 60.0, "resolution_px": 257, "surroundings": "plain"}


def walled_world(*, rock_faces: bool | None = None, **rock: Any) -> Simulation:
    materials = {} if rock_faces is None else {"rock_faces": rock_faces}
    return covered_world({**ROCK, **rock}, stage=STAGE, materials=materials)


def view_of_wall(world: Simulation, T: FloatArray) -> dict[str, Frame]:
    """Return the frames of a camera in front of a piece of a wall, by modality."""
    target_m = T[:3, 3]
    eye_m = target_m + 1.5 * T[:3, 2]
    pose = pose_looking_at(tuple(eye_m), tuple(target_m))
    metadata = ModuleMetadata(sensor={"pose": pose, "pose_policy": "allow"})
    sample = world.step_sample(metadata)
    return {each.modality: each for each in sample.frames}


@pytest.fixture(scope="module")
def terrain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a wall that somebody has measured."""
    path = tmp_path_factory.mktemp("terrain") / "wall.obj"
    x, y = (each.ravel() for each in np.meshgrid(np.arange(-30, 31), np.arange(-30, 31)))
    z = 14 * np.clip((x + 2 * np.sin(0.3 * y)) / 6, 0, 1)
    first = (np.arange(60)[:, None] * 61 + np.arange(60)).ravel() + 1
    faces = np.column_stack((first, first + 1, first + 62, first + 61))
    lines = [f"v {' '.join(map(str, each))}" for each in zip(x, y, z, strict=True)]
    lines += [f"f {' '.join(map(str, each))}" for each in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="module")
def broken() -> Simulation:
    return walled_world()


@pytest.fixture(scope="module")
def plain() -> Simulation:
    return walled_world(rock_faces=False)


def largest(world: Simulation) -> FloatArray:
    T = poses(cover(world))
    return T[np.argmax(np.linalg.norm(T[:, :3, 0], axis=1))]


def test_walls_of_rock_on_a_preset_with_walls_are_broken(
    broken: Simulation, plain: Simulation
) -> None:
    assert len(poses(cover(broken))) > 100
    assert not cover(plain)
    assert {each.semantic_ids for each in cover(broken)} == {(3,)}
    assert all(each.is_rock_face for each in cover(broken))


def test_a_layer_decides_for_itself() -> None:
    assert not cover(walled_world(texture="gravel"))
    assert not cover(walled_world(rock_faces=True, texture="gravel"))
    layer = {**ROCK, "texture": "gravel", "rock_faces": True}
    assert cover(covered_world(layer, stage=STAGE))
    assert not cover(covered_world({**ROCK, "rock_faces": False}, stage=STAGE))


@pytest.mark.parametrize("preset", ["mesa", "mounds", "plane"])
def test_the_ground_of_a_batch_decides_whether_walls_are_broken(preset: str, terrain: Path) -> None:
    """A server may have another preset than its requests: what is measured must stay as it is."""
    world = covered_world(ROCK, stage={**STAGE, "preset": preset, "relief_m": 12.0})
    expected = {"mesa": True, "mounds": False}
    for asked, is_broken in [*expected.items(), ("mesa", True)]:
        world.step_batch(ModuleMetadata(custom={"stage": {"preset": asked}}))
        assert bool(cover(world)) is is_broken, asked
    mesh = {"preset": "mesa", "mesh": {"file": str(terrain)}}
    world.step_batch(ModuleMetadata(custom={"stage": mesh}))
    assert not cover(world)
    world.step_batch(ModuleMetadata(custom={"stage": mesh, "materials": {"rock_faces": True}}))
    assert cover(world)


def test_a_stored_ground_is_as_broken_as_it_was(terrain: Path, tmp_path: Path) -> None:
    stage = {**STAGE, "store": str(tmp_path)}
    world = covered_world(ROCK, stage=stage)
    for name, own in (("measured", {"mesh": {"file": str(terrain)}}), ("drawn", {})):
        world.step_batch(ModuleMetadata(custom={"stage": {**own, "save_as": name}}))
    for name, is_broken in (("measured", False), ("drawn", True)):
        world.step_batch(ModuleMetadata(custom={"stage": {"reuse": {"name": name}}}))
        assert bool(cover(world)) is is_broken, name
        other = covered_world(ROCK, stage={**stage, "preset": "mounds", "reuse": {"name": name}})
        assert bool(cover(other)) is is_broken, name


def test_what_covers_the_ground_lies_on_their_ledges(broken: Simulation) -> None:
    snow = {"texture": "snow", "label": "snow", "semantic_id": 5, "when": {"slope_deg": [0, 40]}}
    rock = {**ROCK, "when": {"slope_deg": [40, 90]}}
    world = covered_world(rock, snow, stage=STAGE)
    ids = {each.semantic_ids for each in cover(world)}
    assert ids == {(3,), (5,)}
    assert all(each.is_rock_face for each in cover(world))
    ledges = [each for each in cover(world) if each.semantic_ids == (5,)]
    looks = {id(world.scene.prototypes[each.prototype].ground) for each in ledges}
    assert len(looks) == 1
    # Each lies in a piece of rock, which is as it was.
    assert {pose.tobytes() for pose in poses(ledges)} <= {
        pose.tobytes() for each in cover(world) if each not in ledges for pose in each.T_map_object
    }
    assert all(each.semantic_ids == (3,) for each in cover(broken))


def test_they_are_seen_as_their_layer_and_are_no_instances(
    broken: Simulation, plain: Simulation
) -> None:
    at = largest(broken)
    seen, before = view_of_wall(broken, at), view_of_wall(plain, at)
    depth_m, smooth_m = seen["depth"].data, before["depth"].data
    both = np.isfinite(depth_m) & np.isfinite(smooth_m)
    nearer_m = smooth_m[both] - depth_m[both]
    assert (nearer_m > 0.02).mean() > 0.3
    assert nearer_m.min() > -1e-3
    assert (seen["semantic_0"].data[both] == 3).all()
    assert not seen["instance"].data.any()
    assert broken.list_objects(ObjectQuery()).total == plain.list_objects(ObjectQuery()).total


def test_the_ground_truth_mesh_has_them_where_depth_shows_them(broken: Simulation) -> None:
    mesh = broken.ground_truth_mesh()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices_m.astype(np.float32), mesh.triangles.astype(np.uint32))
    frame = view_of_wall(broken, largest(broken))["depth"]
    directions = pixel_rays(frame.intrinsics).reshape(-1, 3) @ frame.T_map_camera[:3, :3].T
    origins_m = np.broadcast_to(frame.T_map_camera[:3, 3], directions.shape)
    found = scene.cast_rays(np.concatenate((origins_m, directions), axis=1).astype(np.float32))
    depth_m, seen_m = found["t_hit"].numpy(), frame.data.ravel()
    both = np.isfinite(depth_m) & np.isfinite(seen_m)
    assert both.mean() > 0.9
    error_m = np.abs(depth_m - seen_m)[both]
    # Where a ray grazes an edge, float32 may decide otherwise.
    assert np.quantile(error_m, 0.99) < 1e-4
    assert mesh.instance_ids is not None
    ids = mesh.instance_ids[found["primitive_ids"].numpy()[both]]
    assert (ids == 0).all()
    assert len(mesh.triangles) > 2 * 256 * 256


def test_a_camera_has_to_be_above_them(broken: Simulation) -> None:
    T = poses(cover(broken))
    middle_m = T[:, :3, 3] + 0.1 * T[:, :3, 2]
    found = broken.query_height(middle_m)
    above_m = found.surface_height_m - found.ground_height_m
    assert above_m.min() >= 0
    assert (above_m > 0.1).mean() > 0.2


def test_the_same_seed_draws_the_same_rock(broken: Simulation) -> None:
    assert poses(cover(walled_world())).tobytes() == poses(cover(broken)).tobytes()
