"""What colour shows beyond the stage, depth and labels say: a surface up to the horizon."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from numpy.typing import NDArray
from repository import REPOSITORY

from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import T_LINK_OPTICAL, pixel_rays, pose_to_matrix
from oaisys_core.simulation import Simulation
from oaisys_core.terrain.presets import PRESETS
from oaisys_core.types import FloatArray, ModuleMetadata, PinholeIntrinsics, Pose, Sample

EXAMPLES = REPOSITORY / "config" / "examples"

SKY_ID, FAR_ID = 70, 80

HALF_M = 20.0

CAMERA: dict[str, Any] = {"name": "camera", "width_px": 96, "height_px": 72, "fx_px": 80.0}
MODALITIES = ["depth", "range", "semantic_0", "instance", "normal", "flow", "rgb", "albedo"]

WORLD: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"extent_m": 2 * HALF_M, "resolution_px": 65},
    "materials": {
        "layers": [
            {"texture": "gravel", "label": "gravel", "semantic_id": 1},
            {"texture": "sand", "label": "sand", "semantic_id": 2},
        ],
        "mask": {"size_px": 64, "scale_m": 12.0},
        "texture_size_px": 64,
    },
    "assets": {"rocks": []},
    "environment": {"sky_semantic_id": SKY_ID},
    "sensors": {
        "pose_policy": "allow",
        "cameras": [CAMERA | {"fy_px": 78.0, "modalities": MODALITIES}],
    },
}


def level(xy_m: FloatArray, z_m: float, yaw_rad: float) -> Pose:
    """A pose of a camera that looks level."""
    x, y = xy_m
    return Pose((x, y, z_m), (0.0, 0.0, float(np.sin(yaw_rad / 2)), float(np.cos(yaw_rad / 2))))


def rays_of(sample: Sample) -> FloatArray:
    """(H, W, 3) rays in ``map``, of planar length 1."""
    frame = sample.frames[0]
    return np.asarray(pixel_rays(frame.intrinsics) @ frame.T_map_camera[:3, :3].T)


def images_of(sample: Sample) -> dict[str, NDArray[Any]]:
    return {frame.modality: frame.data for frame in sample.frames}


def world(**environment: Any) -> Simulation:
    config = WORLD | {"environment": WORLD["environment"] | environment}
    return Simulation(config_from_mapping(config))


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_every_ray_below_the_horizon_meets_ground_with_a_label(preset: str) -> None:
    rng = np.random.default_rng(3)
    simulation = world()
    simulation.step_batch(ModuleMetadata(custom={"stage": {"preset": preset}}))
    for _ in range(8):
        xy_m = rng.uniform(-0.95 * HALF_M, 0.95 * HALF_M, 2)
        z_m = simulation.query_height([(*xy_m, 0.0)]).surface_height_m[0] + rng.uniform(1.0, 3.0)
        pose = level(xy_m, z_m, rng.uniform(0.0, 2 * np.pi))
        sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))
        images, below = images_of(sample), rays_of(sample)[..., 2] < 0
        assert 0.4 < below.mean() < 0.6
        assert np.isfinite(images["depth"][below]).all()
        assert np.isin(images["semantic_0"][below], (1, 2)).all()
        assert not images["instance"].any()
        assert np.isfinite(images["range"][below]).all()
        np.testing.assert_allclose(np.linalg.norm(images["normal"][below], axis=-1), 1, atol=1e-5)
        missed = np.isinf(images["depth"])
        assert (images["semantic_0"][missed] == SKY_ID).all()


def test_depth_and_flow_on_a_plane_are_those_of_the_plane_at_any_distance() -> None:
    simulation = world()
    simulation.step_batch(ModuleMetadata(custom={"stage": {"preset": "plane"}}))
    poses = [level(np.array((3.0, x)), 2.0, 0.4) for x in (-2.0, -2.5)]
    before, after = (simulation.step_sample(ModuleMetadata(sensor={"pose": p})) for p in poses)
    rays = rays_of(after)
    below = rays[..., 2] < 0
    depth_m = images_of(after)["depth"]
    np.testing.assert_allclose(depth_m[below], -2.0 / rays[..., 2][below], rtol=3e-7)
    assert depth_m[below].max() > 300.0
    assert np.isinf(depth_m[~below]).all()

    T_before_map = np.linalg.inv(pose_to_matrix(poses[0]) @ T_LINK_OPTICAL)
    points_m = before.frames[0].T_map_camera[:3, 3] + (0, -0.5, 0)
    points_m = points_m + (-2.0 / rays[below][:, 2:]) * rays[below]
    earlier = (points_m @ T_before_map[:3, :3].T + T_before_map[:3, 3]) @ intrinsics_of(after).K.T
    v, u = np.nonzero(below)
    flow = np.column_stack((u, v)) - earlier[:, :2] / earlier[:, 2:]
    np.testing.assert_allclose(images_of(after)["flow"][below], flow, atol=2e-3)


def intrinsics_of(sample: Sample) -> PinholeIntrinsics:
    return sample.frames[0].intrinsics


def test_labels_go_on_mirrored_as_the_picture_does() -> None:
    simulation = world()
    simulation.step_batch(ModuleMetadata(custom={"stage": {"preset": "plane"}}))
    rng = np.random.default_rng(4)
    inside_m = rng.uniform(-HALF_M, HALF_M, (400, 2))
    material = simulation.scene.material
    across_m = inside_m * (-1, 1) + (2 * HALF_M, 0)
    np.testing.assert_array_equal(
        material.semantic_ids_at(across_m), material.semantic_ids_at(inside_m)
    )


def test_a_label_of_its_own_goes_to_what_lies_beyond() -> None:
    simulation = world(ground_beyond_label={"label": "far", "semantic_id": FAR_ID})
    simulation.step_batch(ModuleMetadata(custom={"stage": {"preset": "plane"}}))
    pose = level(np.array((0.0, 0.0)), 2.0, 0.0)
    images = images_of(simulation.step_sample(ModuleMetadata(sensor={"pose": pose})))
    labels, depth_m = images["semantic_0"], images["depth"]
    assert (labels[(depth_m > HALF_M + 0.01) & np.isfinite(depth_m)] == FAR_ID).all()
    assert np.isin(labels[depth_m < HALF_M - 0.01], (1, 2)).all()


def test_meshes_and_heights_end_with_the_stage_and_no_plain_is_no_ground() -> None:
    simulation = world()
    simulation.step_batch()
    mesh = simulation.ground_truth_mesh()
    assert np.abs(mesh.vertices_m[:, :2]).max() <= HALF_M
    assert np.isnan(simulation.query_height([(HALF_M + 1, 0.0, 9.0)]).surface_height_m).all()

    bare = world(ground_beyond=False)
    bare.step_batch(ModuleMetadata(custom={"stage": {"preset": "plane"}}))
    sample = bare.step_sample(
        ModuleMetadata(sensor={"pose": level(np.array((0.0, 0.0)), 2.0, 0.0)})
    )
    depth_m = images_of(sample)["depth"]
    assert depth_m[np.isfinite(depth_m)].max() <= HALF_M + 0.01


@pytest.mark.long
@pytest.mark.blender
@pytest.mark.parametrize("example", ["stage_plane", "environment_moon", "stage_dem", "stage_dunes"])
def test_no_pixel_that_shows_ground_is_infinitely_far(example: str) -> None:
    """Level views: colour's own depth, as Cycles rendered it, against what the sample says."""
    rng = np.random.default_rng(6)
    places = np.column_stack((rng.uniform(-0.9, 0.9, (6, 2)), rng.uniform(0, 6.3, 6)))
    changes = {
        "camera": {"modalities": ("rgb", "depth", "semantic_0")},
        "environment": {"sky_semantic_id": SKY_ID, "ground_beyond_label": None},
    }
    path = str(EXAMPLES / f"{example}.yaml")
    views = in_blender("beyond.level_views", path, changes, places.tolist())
    assert len(views) == len(places)
    far = 0
    for images in views:
        shown = images["cycles"] < 1e9
        assert 0.2 < shown.mean() < 0.95
        assert np.isfinite(images["depth"][shown]).all()
        assert (images["semantic_0"][shown] != SKY_ID).all()
        assert np.isin(images["semantic_0"][~shown], (SKY_ID,)).all()
        ratio = images["depth"][shown] / images["cycles"][shown]
        # Cycles' rays are up to 0.005 px beside ours.
        assert np.median(np.abs(ratio - 1)) < 1e-4
        far += int((images["depth"][shown] > 60.0).sum())
    assert far > 100
