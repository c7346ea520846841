"""What colour shows beyond the stage, depth and labels say: a surface up to the horizon."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from numpy.typing import NDArray
from repository import REPOSITORY
from scipy.ndimage import maximum_filter, minimum_filter

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import T_LINK_OPTICAL, pixel_rays, pose_to_matrix
from oaisys_core.procedural.terrain.presets import PRESETS
from oaisys_core.raycast.far_ground import FarGroundTarget, far_triangles
from oaisys_core.simulation import Simulation
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


SLOW = {"alpine", "badlands", "river_bed", "slab_dunes", "volcanic_field", "large_terrain"}
"""Presets that take seconds to make."""
ALIKE = {"another_noise", "craters", "mountain_1"}
"""Presets whose edges are as those of `mounds`, `crater_field` and `mountain_2`."""
QUICK = {"canyon", "crater_field", "mounds", "plane"}
"""Presets of `make test`: walls, pits, hills, nothing."""


def preset_marks(preset: str) -> Any:
    """When what holds for all presets is seen for this one."""
    if preset in QUICK:
        return ()
    return pytest.mark.soak if preset in SLOW | ALIKE else pytest.mark.long


ALL_PRESETS = [pytest.param(preset, marks=preset_marks(preset)) for preset in sorted(PRESETS)]


@pytest.mark.parametrize("preset", ALL_PRESETS)
def test_every_ray_below_the_horizon_meets_ground_with_a_label(preset: str) -> None:
    rng = np.random.default_rng(3)
    simulation = world()
    simulation.step_batch(ModuleMetadata(custom={"stage": {"preset": preset}}))
    for _ in range(5):
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


OUTSIDE = [(HALF_M + 1, 0.0, 9.0), (-3 * HALF_M, 900.0, 9.0)]


def test_the_truth_mesh_ends_with_the_stage_but_heights_only_with_the_land() -> None:
    simulation = world()
    simulation.step_batch()
    mesh = simulation.ground_truth_mesh()
    assert np.abs(mesh.vertices_m[:, :2]).max() <= HALF_M
    found = simulation.query_height(OUTSIDE)
    np.testing.assert_allclose(found.ground_height_m, found.surface_height_m)
    for (x, y, z), height_m in zip(OUTSIDE, found.ground_height_m, strict=True):
        down = Pose((x, y, z + 100.0), (0.0, float(np.sqrt(0.5)), 0.0, float(np.sqrt(0.5))))
        images = images_of(simulation.step_sample(ModuleMetadata(sensor={"pose": down})))
        nearest = images["depth"][35:37, 47:49]
        assert nearest.min() - 1.5 < z + 100.0 - height_m < nearest.max() + 1.5
    assert np.isnan(simulation.query_height(OUTSIDE, on_stage=True).clearance_m).all()
    for where in (
        {"custom": {"stage": {"surroundings": "plain"}}},
        {"environment": {"ground_beyond": False}},
        {"custom": {"stage": {"preset": "plane"}}},
    ):
        simulation.step_batch(ModuleMetadata(**where))
        heights = simulation.query_height(OUTSIDE)
        assert np.isnan(heights.ground_height_m).all()
        assert np.isnan(heights.surface_height_m).all()


def test_a_pose_off_the_stage_is_refused_although_there_is_land() -> None:
    simulation = world()
    simulation.step_batch()
    pose = Pose((HALF_M + 1, 0.0, 50.0), (0.0, 0.0, 0.0, 1.0))
    with pytest.raises(InvalidInputError, match="off the stage"):
        simulation.step_sample(ModuleMetadata(sensor={"pose": pose, "pose_policy": "reject"}))


@pytest.mark.parametrize("preset", ["mounds", "canyon"])
def test_on_the_stage_land_and_plain_give_the_same_bytes(preset: str) -> None:
    pose = level(np.array((2.0, -11.0)), 3.0, 1.1)
    seen = []
    for surroundings in ("land", "plain"):
        simulation = world()
        stage = {"preset": preset, "surroundings": surroundings}
        simulation.step_batch(ModuleMetadata(custom={"stage": stage}))
        sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))
        images = images_of(sample)
        depth_m = np.minimum(images["depth"], 1e6)
        points_m = np.array(pose.position_m) + depth_m[..., None] * rays_of(sample)
        on_stage = (np.abs(points_m[..., :2]) < HALF_M - 1e-3).all(axis=-1)
        seen.append((images, on_stage, simulation.scene.stage_hash))
    (land, on_land_stage, land_hash), (plain, on_plain_stage, plain_hash) = seen
    assert land_hash == plain_hash
    assert 0.1 < on_plain_stage.mean() < 0.9
    np.testing.assert_array_equal(on_land_stage, on_plain_stage)
    for name in ("depth", "semantic_0", "instance", "normal"):
        np.testing.assert_array_equal(land[name][on_land_stage], plain[name][on_land_stage])


def test_sky_reaches_below_the_horizontal_as_a_moon_curves_away() -> None:
    beyond = {"label": "far", "semantic_id": FAR_ID}
    simulation = world(ground_beyond_label=beyond)
    simulation.step_batch(ModuleMetadata(custom={"stage": {"body": 4e4}}))
    height_m = 2000.0
    pose = level(np.array((0.0, 0.0)), height_m, 0.3)
    sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))
    images, rays = images_of(sample), rays_of(sample)
    dip_rad = np.sqrt(2 * height_m / 4e4)
    down_rad = -np.arctan2(rays[..., 2], np.hypot(rays[..., 0], rays[..., 1]))
    between = (down_rad > 0.01) & (down_rad < dip_rad - 0.12)
    assert between.mean() > 0.02
    assert np.isinf(images["depth"][between]).all()
    assert (images["semantic_0"][between] == SKY_ID).all()
    below = down_rad > dip_rad + 0.06
    assert np.isfinite(images["depth"][below]).all()
    assert (images["semantic_0"][below] == FAR_ID).any()


def test_no_ray_passes_between_land_and_a_stage_with_detail_at_its_edge() -> None:
    config = WORLD | {
        "stage": WORLD["stage"] | {"detail": {"amplitude_m": 0.2, "spacing_m": 0.1}},
        "environment": WORLD["environment"]
        | {"ground_beyond_label": {"label": "far", "semantic_id": FAR_ID}},
    }
    simulation = Simulation(config_from_mapping(config))
    simulation.step_batch()
    for yaw_rad in np.linspace(-0.6, 0.6, 5):
        pose = level(np.array((HALF_M - 1.0, 3.0)), 0.0, float(yaw_rad))
        ground_m = simulation.query_height([pose.position_m]).surface_height_m[0]
        pose = level(np.array((HALF_M - 1.0, 3.0)), float(ground_m) + 1.0, float(yaw_rad))
        depth_m = images_of(simulation.step_sample(ModuleMetadata(sensor={"pose": pose})))["depth"]
        # In each column, everything below the horizon is ground, and nothing is far below the edge.
        is_ground = np.isfinite(depth_m)
        assert (np.diff(is_ground.astype(int), axis=0) >= 0).all()
        assert depth_m[-10:].max() < 40.0


@pytest.mark.parametrize("surroundings", ["land", "plain"])
def test_no_ray_is_left_out_that_meets_the_ground_beyond(surroundings: str) -> None:
    simulation = world()
    stage = {"preset": "mountain_1", "surroundings": surroundings}
    simulation.step_batch(ModuleMetadata(custom={"stage": stage}))
    far_ground = simulation.scene.far_ground
    assert far_ground is not None
    target = FarGroundTarget(far_ground)
    rng = np.random.default_rng(8)
    met = 0
    for height_m in (-3.0, 0.0, 2.0, 60.0):
        origin_m = np.array((*rng.uniform(-19.9, 19.9, 2), height_m))
        directions = rng.normal(size=(20_000, 3)) * (1, 1, 0.15)
        found_m, _ = target.intersect(origin_m, directions)
        expected_m, _ = far_triangles(far_ground).intersect(origin_m, directions)
        hit = np.isfinite(expected_m)
        assert (found_m[hit] <= expected_m[hit]).all()
        origins_m = np.tile(origin_m, (len(directions), 1))
        np.testing.assert_array_equal(target.occludes(origins_m, directions), np.isfinite(found_m))
        met += int(hit.sum())
    assert met > 1000


def horizon_roughness_px(simulation: Simulation, pose: Pose) -> float | None:
    """RMS distance in pixels of the horizon from the line that fits it best; None without sky."""
    images = images_of(simulation.step_sample(ModuleMetadata(sensor={"pose": pose})))
    is_ground = np.isfinite(images["depth"])
    if is_ground.all():
        return None
    row = is_ground.argmax(axis=0).astype(float)
    column = np.arange(len(row))
    line = np.polynomial.Polynomial.fit(column, row, 1)
    return float(np.sqrt(np.mean((row - line(column)) ** 2)))


PANORAMA = {"name": "camera", "width_px": 640, "height_px": 200, "fx_px": 541.14}


@pytest.mark.parametrize("preset", ALL_PRESETS)
def test_the_horizon_is_no_straight_line(preset: str) -> None:
    """Level views from 1.5 to 200 m above the stages of the demo's size."""
    config = WORLD | {
        "stage": {"extent_m": 64.0, "resolution_px": 257, "preset": preset},
        "sensors": {"pose_policy": "allow", "cameras": [PANORAMA | {"modalities": ["depth"]}]},
    }
    simulation = Simulation(config_from_mapping(config))
    simulation.step_batch()
    rng = np.random.default_rng(12)
    for height_m in (1.5, 8.0, 40.0, 200.0):
        found = None
        while found is None:  # A wall of the canyon may hide all of the sky.
            xy_m = rng.uniform(-28.0, 28.0, 2)
            z_m = float(simulation.query_height([(*xy_m, 0.0)]).surface_height_m[0]) + height_m
            found = horizon_roughness_px(simulation, level(xy_m, z_m, rng.uniform(0, 2 * np.pi)))
        assert found < 0.5 if preset == "plane" else found >= 1.0, height_m


def test_no_plain_is_no_ground() -> None:
    bare = world(ground_beyond=False)
    bare.step_batch(ModuleMetadata(custom={"stage": {"preset": "plane"}}))
    sample = bare.step_sample(
        ModuleMetadata(sensor={"pose": level(np.array((0.0, 0.0)), 2.0, 0.0)})
    )
    depth_m = images_of(sample)["depth"]
    assert depth_m[np.isfinite(depth_m)].max() <= HALF_M + 0.01


@pytest.mark.long
@pytest.mark.blender
def test_sky_is_shown_where_the_horizon_dips_below_the_horizontal() -> None:
    """From 8 km above the Moon, whose sky is black: what is not black has a depth."""
    changes = {
        "camera": {"modalities": ("rgb", "depth", "semantic_0")},
        "environment": {"sky_semantic_id": SKY_ID, "sun_disc": 0.0},
    }
    path = str(EXAMPLES / "environment_moon.yaml")
    (images,) = in_blender("beyond.level_views", path, changes, [(0.0, 0.0, 2.6)], 8000.0)
    shown, is_ground = images["cycles"] < 1e9, np.isfinite(images["depth"])
    rows = np.arange(len(shown))[:, None] + np.zeros(shown.shape[1])
    dips = ~shown & (rows > len(shown) / 2 + 0.5)
    assert dips.sum() > shown.shape[1]
    inner = minimum_filter(shown, 3) == maximum_filter(shown, 3)
    np.testing.assert_array_equal(shown[inner], is_ground[inner])
    # Denoising spreads a little light over the silhouette.
    assert images["rgb"][~shown & inner].max() < 12
    assert images["rgb"][~shown & inner].mean() < 0.5
    assert images["rgb"][shown & inner].min() > 12
    assert (images["semantic_0"][dips & inner] == SKY_ID).all()


@pytest.mark.blender
@pytest.mark.parametrize(
    "example",
    [
        pytest.param("stage_plane", marks=pytest.mark.long),
        pytest.param("environment_moon", marks=pytest.mark.long),
        pytest.param("stage_dem", marks=pytest.mark.soak),
        pytest.param("stage_dunes", marks=pytest.mark.soak),
    ],
)
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
        is_ground = np.isfinite(images["depth"])
        # Cycles' rays are up to 0.005 px beside ours, which matters at the silhouette alone.
        differs = is_ground != shown
        assert differs.sum() <= 2
        assert not (differs & (minimum_filter(shown, 3) == maximum_filter(shown, 3))).any()
        np.testing.assert_array_equal(images["semantic_0"] != SKY_ID, is_ground)
        ratio = images["depth"][shown & is_ground] / images["cycles"][shown & is_ground]
        assert np.median(np.abs(ratio - 1)) < 1e-4
        far += int((images["depth"][shown] > 60.0).sum())
    assert far > 100
