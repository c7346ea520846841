"""The rig's cameras: mounts, pairs, turns, lenses, and what a step may change of them."""

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oaisys_core.config import adjust, config_from_mapping
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.geometry import pose_looking_down, project, unproject
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.render.base import FrameGroup
from oaisys_core.scene import Lens, PlacedCamera
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, Pose, Sample

WORLD: dict[str, Any] = {
    "backend": "analytic",
    "stage": {
        "surroundings": "plain",
        "preset": "mounds",
        "extent_m": 24,
        "resolution_px": 33,
        "relief_m": 0,
    },
    "materials": {
        "layers": [{"texture": "gravel", "label": "gravel", "semantic_id": 1}],
        "texture_size_px": 16,
        "mask": {"size_px": 16, "relief": 0},
    },
    "assets": {"rocks": []},
}
SMALL = {"width_px": 16, "height_px": 12, "fx_px": 13.5, "fy_px": 13.5}
BENT = {"k1": -0.2, "k2": 0.05, "p1": 0.002, "p2": -0.001, "k3": 0.0}


class Watching(AnalyticBackend):
    """Remembers which cameras it was given."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[tuple[PlacedCamera, ...]] = []

    def render(
        self, cameras: Any, settings: RenderSettings, *callbacks: Any
    ) -> Iterator[FrameGroup]:
        """Render, and remember."""
        self.seen.append(tuple(cameras))
        return super().render(cameras, settings, *callbacks)


def simulation(backend: AnalyticBackend | None = None, **sensors: Any) -> Simulation:
    made = Simulation(config_from_mapping({**WORLD, "sensors": sensors}), backend)
    made.step_batch(seed=3)
    return made


def test_the_rig_starts_above_water_that_is_deep() -> None:
    stage = {"preset": "canyon", "extent_m": 300, "resolution_px": 129}
    stage["water"] = {"level_share": 0.2, "semantic_id": 230}
    made = Simulation(config_from_mapping({**WORLD, "stage": stage}))
    made.step_batch()
    pose = made.info().rig_pose
    assert pose is not None
    found = made.query_height([pose.position_m])
    assert found.ground_height_m[0] < found.surface_height_m[0] - 10
    assert pose.position_m[2] == pytest.approx(found.surface_height_m[0] + 10, abs=0.1)


def test_the_rig_has_a_start_pose_until_a_sample_moves_it() -> None:
    assert Simulation(config_from_mapping(WORLD)).info().rig_pose is None
    above = simulation().info()
    down = pose_looking_down(0.0, 0.0, 10.0)
    assert above.rig_pose is not None
    assert above.rig_pose.position_m == pytest.approx(down.position_m, abs=0.1)
    assert above.rig_pose.quat_xyzw == down.quat_xyzw
    assert not above.odometry_drifts

    rounded = {"position_m": [1.0, -2.0, 6.0], "quat_xyzw": [0.0, 0.38, 0.0, 0.93]}
    made = simulation(start_pose=rounded, faults={"drift_m": 0.1})
    start = made.info().rig_pose
    assert start is not None
    assert start.position_m == (1.0, -2.0, 6.0)
    assert np.linalg.norm(start.quat_xyzw) == pytest.approx(1.0, abs=1e-12)
    assert made.info().odometry_drifts
    assert made.step_sample().rig_pose == start
    made.step_sample(at(3.0))
    assert made.info().rig_pose == pose_looking_down(3.0, 0, 9)
    made.step_batch(seed=4)
    assert made.info().rig_pose == start


def at(x: float, **settings: Any) -> ModuleMetadata:
    return ModuleMetadata(sensor={"pose": pose_looking_down(x, 0, 9), **settings})


def rendered(sample: Sample) -> list[tuple[str, str]]:
    return [(frame.sensor, frame.modality) for frame in sample.frames]


def test_each_camera_has_its_own_mount_image_and_modalities() -> None:
    quat = Rotation.from_euler("xyz", (10, 20, -30), degrees=True).as_quat().tolist()
    mount = {"mount_position_m": [0.3, -0.2, 0.1], "mount_quat_xyzw": quat}
    made = simulation(
        cameras=[
            {**SMALL, "name": "a", "modalities": ["depth"]},
            {**SMALL, "name": "b", **mount, "width_px": 20, "fy_px": 17, "modalities": ["range"]},
        ],
        pose_policy="allow",
    )
    rig = Pose((1.0, 2.0, 5.0), (0.0, 0.0, 0.0, 1.0))
    sample = made.step_sample(ModuleMetadata(sensor={"pose": rig}))
    assert rendered(sample) == [("a", "depth"), ("b", "range")]
    assert sample.frames[1].data.shape == (12, 20)
    # The optical axes in the link are: z = link's x, x = -link's y, y = -link's z.
    R_link = Rotation.from_quat(quat).as_matrix()
    T = sample.frames[1].T_map_camera
    np.testing.assert_allclose(T[:3, 2], R_link[:, 0], atol=1e-12)
    np.testing.assert_allclose(T[:3, 0], -R_link[:, 1], atol=1e-12)
    np.testing.assert_allclose(T[:3, 3], (1.3, 1.8, 5.1), atol=1e-12)


def test_a_stereo_pair_is_rectified_as_its_baseline_says() -> None:
    quat = Rotation.from_euler("xyz", (3, 40, 25), degrees=True).as_quat().tolist()
    pair = {**SMALL, "name": "eyes", "baseline_m": 0.25, "mount_quat_xyzw": quat, "cx_px": 6.2}
    made = simulation(stereo=[pair])
    left, right = made.info().sensors
    assert (left.name, right.name) == ("eyes_left", "eyes_right")
    assert (left.stereo_baseline_m, right.stereo_baseline_m) == (0, 0.25)
    assert left.intrinsics == right.intrinsics
    points_m = np.random.default_rng(2).uniform((-1, -1, 2), (1, 1, 8), (20, 3))
    T_right_left = np.linalg.inv(right.T_base_camera) @ left.T_base_camera
    in_right_m = points_m @ T_right_left[:3, :3].T + T_right_left[:3, 3]
    seen_left, seen_right = (project(p, left.intrinsics) for p in (points_m, in_right_m))
    disparity_px = left.intrinsics.fx_px * 0.25 / points_m[:, 2]
    np.testing.assert_allclose(
        seen_left - seen_right, np.column_stack((disparity_px, 0 * disparity_px)), atol=1e-9
    )


def test_pairs_and_cameras_share_a_space_of_names() -> None:
    rig = {"stereo": [{"name": "s"}], "cameras": [{"name": "front"}]}
    cameras = config_from_mapping({"sensors": rig}).sensors.all_cameras
    assert [camera.name for camera in cameras] == ["front", "s_left", "s_right"]
    with pytest.raises(ConfigError, match="different names"):
        config_from_mapping({"sensors": {**rig, "cameras": [{"name": "s_left"}]}})
    with pytest.raises(ConfigError, match="a camera or a stereo pair"):
        config_from_mapping({"sensors": {"cameras": []}})


def test_a_pair_is_resized_as_a_camera_is() -> None:
    config = config_from_mapping({"sensors": {"stereo": [{"name": "s", "distortion": BENT}]}})
    left, right = adjust(config, size="320x240").sensors.all_cameras
    assert (left.width_px, left.fx_px, right.height_px) == (320, 541.14 / 2, 240)


def test_cameras_and_modalities_take_turns() -> None:
    made = simulation(
        cameras=[
            {**SMALL, "name": "a", "modalities": ["depth", "instance"],
             "modality_intervals": {"instance": 2}},
            {**SMALL, "name": "b", "modalities": ["depth", "range"], "step_interval": 3,
             "step_offset": 1, "modality_intervals": {"range": 2}},
        ]
    )  # fmt: skip
    taken = [rendered(made.step_sample()) for _ in range(6)]
    often, rarely = [("a", "depth")], [("a", "depth"), ("a", "instance")]
    assert taken == [
        rarely,
        [*often, ("b", "depth"), ("b", "range")],
        rarely,
        often,
        [*rarely, ("b", "depth")],
        often,
    ]


def test_what_is_asked_for_by_name_renders_out_of_turn() -> None:
    camera = {**SMALL, "modalities": ["depth", "instance"], "step_interval": 9}
    made = simulation(cameras=[{**camera, "name": "a"}, {**camera, "name": "b"}])
    made.step_sample()
    assert rendered(made.step_sample()) == []
    assert rendered(made.step_sample(sensors=["b"])) == [("b", "depth"), ("b", "instance")]
    assert rendered(made.step_sample(modalities=["depth"])) == [("a", "depth"), ("b", "depth")]


PAIR = {**SMALL, "name": "eyes", "modalities": ["rgb", "disparity"]}


@pytest.mark.parametrize("render", [{"quality": "geometry"}, {"passes": ["disparity"]}])
def test_disparity_needs_no_colour(render: dict[str, Any]) -> None:
    made = simulation(stereo=[PAIR])
    disparity = [("eyes_left", "disparity"), ("eyes_right", "disparity")]
    assert rendered(made.step_sample(ModuleMetadata(render=render))) == disparity
    assert rendered(made.step_sample(modalities=["disparity"])) == disparity


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({"modalities": ["rgb", "depth"]}, "'rgb', expected one that neither quality"),
        ({"modalities": ["rgb"], "sensors": ["colour"]}, "modalities: received 'rgb'"),
        ({"sensors": ["mono", "colour"]}, "sensors: received 'colour', .* it has rgb"),
        ({"sensors": ["mono"], "modalities": ["depth", "disparity"]}, "'disparity', .* mono can"),
        ({"sensors": ["mono", "eyes_left"], "modalities": ["depth"]}, "'eyes_left'.* depth; it h"),
    ],
)
def test_an_image_that_would_be_left_out_is_refused(asked: dict[str, Any], told: str) -> None:
    mono = {**SMALL, "name": "mono", "modalities": ["rgb", "depth"]}
    colour = {**SMALL, "name": "colour", "modalities": ["rgb"]}
    made = simulation(cameras=[mono, colour], stereo=[PAIR])
    metadata = replace(at(3), render={"quality": "geometry"})
    before = made.state()
    with pytest.raises(InvalidInputError, match=told):
        made.step_sample(metadata, **asked)
    assert made.state() == before
    assert len(rendered(made.step_sample(metadata))) == 3


def test_a_rig_that_would_render_nothing_is_refused() -> None:
    cameras = [{**SMALL, "name": "colour", "modalities": ["rgb"]}]
    made = simulation(cameras=cameras)
    with pytest.raises(InvalidInputError, match=r"metadata.render.quality: received 'geometry'"):
        made.step_sample(ModuleMetadata(render={"quality": "geometry"}))
    config = {**WORLD, "sensors": {"cameras": cameras}, "render": {"quality": "geometry"}}
    with pytest.raises(ConfigError, match=r"render.quality: received 'geometry', .* of rgb"):
        Simulation(config_from_mapping(config))


def test_a_sample_at_which_nobody_renders_still_counts() -> None:
    made = simulation(cameras=[{**SMALL, "step_offset": 2}])
    samples = [made.step_sample(at(x)) for x in range(3)]
    assert [(s.sample_id, len(s.frames)) for s in samples] == [(1, 0), (2, 0), (3, 4)]
    assert [s.rig_pose.position_m[0] for s in samples] == [0, 1, 2]
    assert samples[0].provenance.render_samples == 0


def test_a_camera_knows_where_it_was_at_its_own_previous_sample() -> None:
    backend = Watching()
    mount = {"mount_position_m": [0, 0.5, 0]}
    cameras = [{**SMALL, "name": "a"}, {**SMALL, "name": "b", **mount, "step_interval": 2}]
    made = simulation(backend, cameras=cameras)
    states = []
    for x in range(4):
        made.step_sample(at(x))
        states.append(json.loads(json.dumps(made.state())))
    assert [[c.name for c in seen] for seen in backend.seen] == [["a", "b"], ["a"]] * 2
    a0, b0 = backend.seen[0]
    assert a0.T_map_previous is None
    assert b0.T_map_previous is None
    a2, b2 = backend.seen[2]
    assert a2.T_map_previous is not None
    assert b2.T_map_previous is not None
    np.testing.assert_array_equal(a2.T_map_previous, backend.seen[1][0].T_map_camera)
    np.testing.assert_array_equal(b2.T_map_previous, b0.T_map_camera)

    again = Watching()
    restored = Simulation(config_from_mapping({**WORLD, "sensors": {"cameras": cameras}}), again)
    restored.restore(states[1])
    restored.step_sample(at(2))
    for mine, theirs in zip(again.seen[0], backend.seen[2], strict=True):
        assert mine.T_map_previous is not None
        assert theirs.T_map_previous is not None
        np.testing.assert_array_equal(mine.T_map_previous, theirs.T_map_previous)
    made.step_batch(seed=3)
    made.step_sample(at(7))
    assert backend.seen[-1][0].T_map_previous is None, "a new batch has no past"


def test_lens_and_shutter_reach_the_backend() -> None:
    backend = Watching()
    lens = {"focus_distance_m": 4, "f_number": 1.8, "blades": 6, "blade_rotation_deg": 90}
    made = simulation(backend, cameras=[{**SMALL, "lens": lens, "shutter_share": 0.4}])
    made.step_sample()
    (camera,) = backend.seen[0]
    assert camera.lens == Lens(4.0, 1.8, 6, np.pi / 2, 1.0)
    assert camera.shutter_share == 0.4


def test_a_step_changes_optics_until_the_next_batch() -> None:
    backend = Watching()
    cameras = [{**SMALL, "name": "a"}, {**SMALL, "name": "b"}]
    made = simulation(backend, cameras=cameras)
    zoom = {"a": {"fx_px": 27, "lens": {"f_number": 4}, "distortion": BENT}}
    made.step_sample(at(0, cameras=zoom))
    made.step_sample(at(0, cameras={"a": {"lens": {"focus_distance_m": 2}}}))
    state = json.loads(json.dumps(made.state()))
    for a, b in backend.seen:
        assert (a.intrinsics.fx_px, b.intrinsics.fx_px) == (27, 13.5)
        assert a.intrinsics.distortion == tuple(BENT[k] for k in ("k1", "k2", "p1", "p2", "k3"))
    first, second = (seen[0].lens for seen in backend.seen)
    assert (first, second) == (Lens(10.0, 4.0), Lens(2.0, 4.0))
    assert made.info().sensors[0].intrinsics.fx_px == 27

    again = Watching()
    restored = Simulation(config_from_mapping({**WORLD, "sensors": {"cameras": cameras}}), again)
    restored.restore(state)
    restored.step_sample(at(0, cameras={"a": {"lens": None}}))
    assert again.seen[0][0].lens is None
    assert again.seen[0][0].intrinsics == backend.seen[1][0].intrinsics
    made.step_batch(seed=3)
    assert made.info().sensors[0].intrinsics.fx_px == 13.5


@pytest.mark.parametrize(
    ("sensor", "field"),
    [
        ({"zoom": 2}, "metadata.sensor.zoom"),
        ({"cameras": {"other": {}}}, "metadata.sensor.cameras.other"),
        ({"cameras": {"camera": {"width_px": 9}}}, "metadata.sensor.cameras.camera.width_px"),
        ({"cameras": {"camera": {"fx_px": -1}}}, "metadata.sensor.cameras.camera.fx_px"),
        ({"cameras": {"camera": 3}}, "metadata.sensor.cameras.camera"),
        ({"cameras": {"camera": {"distortion": {"k1": -9}}}}, "metadata.sensor.cameras.camera"),
        (
            {"cameras": {"camera": {"lens": {"f_number": 0}}}},
            "metadata.sensor.cameras.camera.lens.f_number",
        ),
        ({"cameras": ["camera"]}, "metadata.sensor.cameras"),
    ],
)
def test_changes_that_make_no_sense_are_refused_and_change_nothing(
    sensor: dict[str, Any], field: str
) -> None:
    made = simulation(cameras=[SMALL])
    before = made.info()
    with pytest.raises(InvalidInputError) as refused:
        made.step_sample(ModuleMetadata(sensor=sensor))
    assert refused.value.field == field
    assert [s.intrinsics for s in made.info().sensors] == [s.intrinsics for s in before.sensors]
    assert made.info().sample_id == 0


def test_a_lens_that_folds_its_image_is_refused_with_its_path() -> None:
    with pytest.raises(ConfigError, match=r"cameras\.0.*not invertible"):
        config_from_mapping({"sensors": {"cameras": [{"distortion": {"k1": -1}}]}})


def test_disparities_lead_from_one_image_of_a_pair_to_the_other() -> None:
    pair = {**SMALL, "name": "eyes", "baseline_m": 0.25, "modalities": ["depth", "disparity"]}
    quat = Rotation.from_euler("y", 50, degrees=True).as_quat().tolist()
    made = simulation(stereo=[{**pair, "mount_quat_xyzw": quat}], pose_policy="allow")
    sample = made.step_sample(
        ModuleMetadata(sensor={"pose": Pose((0.0, 0.0, 4.0), (0.0, 0.0, 0.0, 1.0))})
    )
    for side, sign in (("left", -1), ("right", 1)):
        depth, disparity = (sample.frame(f"eyes_{side}", m) for m in ("depth", "disparity"))
        assert disparity.data.dtype == np.float32
        np.testing.assert_allclose(disparity.data, 13.5 * 0.25 / depth.data, rtol=1e-6)
        assert (disparity.data[np.isinf(depth.data)] == 0).all()
        other = sample.frame(f"eyes_{'right' if side == 'left' else 'left'}", "depth")
        v, u = np.nonzero(np.isfinite(depth.data))
        points_m = unproject(np.column_stack((u, v)), depth.data[v, u], depth.intrinsics)
        T = np.linalg.inv(other.T_map_camera) @ depth.T_map_camera
        pixels = project(points_m @ T[:3, :3].T + T[:3, 3], other.intrinsics)
        there = u + sign * disparity.data[v, u]
        np.testing.assert_allclose(pixels, np.column_stack((there, v)), atol=1e-4)
        assert len(u) > 20


@pytest.mark.parametrize(
    "sensors",
    [
        {"cameras": [{"modalities": ["disparity"]}]},
        {"stereo": [{"modalities": ["disparity"], "distortion": BENT}]},
    ],
    ids=["single", "distorted"],
)
def test_disparity_needs_a_rectified_pair(sensors: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="disparity"):
        config_from_mapping({"sensors": sensors})


def test_metadata_cannot_distort_a_camera_that_renders_disparity() -> None:
    made = simulation(stereo=[{**SMALL, "name": "s", "modalities": ["disparity"]}])
    with pytest.raises(InvalidInputError, match="disparity"):
        made.step_sample(at(0, cameras={"s_left": {"distortion": BENT}}))
