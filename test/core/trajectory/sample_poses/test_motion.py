"""How the rig moves by itself: where it goes, and that a sample's id alone decides it."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oaisys_core.config import config_from_mapping, load_config
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.geometry import pose_looking_down, pose_to_matrix
from oaisys_core.simulation import Simulation
from oaisys_core.types import FloatArray, ModuleMetadata, Pose, Sample

WORLD: dict[str, Any] = {
    "backend": "analytic",
    "stage": {
        "preset": "mounds",
        "extent_m": 40,
        "resolution_px": 33,
        "surroundings": "plain",
    },
    "materials": {
        "layers": [{"texture": "gravel", "label": "gravel", "semantic_id": 1}],
        "texture_size_px": 16,
        "mask": {"size_px": 16, "relief": 0},
    },
    "assets": {
        "rocks": [],
        "primitives": [
            {"shape": "sphere", "radius_m": 0.5, "position_m": [3, -2, 6], "semantic_id": 20}
        ],
    },
}
CAMERA = {
    "width_px": 16,
    "height_px": 12,
    "fx_px": 13.5,
    "fy_px": 13.5,
    "modalities": ["depth", "instance"],
}
BOX = [[-6, 6], [-4, 4], [7, 9]]
MOTIONS: dict[str, dict[str, Any]] = {
    "random": {"kind": "random", "position_m": BOX, "pitch_deg": [10, 40]},
    "hover": {"kind": "hover", "height_above_ground_m": [2, 3], "height_noise_m": 0.1},
    "around": {"kind": "around_target", "target_above_ground": True, "roll_deg": [-5, 5]},
    "look_at": {"kind": "look_at", "position_m": BOX, "target_noise_m": 0.3},
    "grid": {"kind": "grid", "columns": 3, "rows": 2, "altitude_m": 6},
    "spline": {"kind": "spline", "waypoints_m": [[-5, 0, 7], [0, 3, 8], [6, 0, 7]]},
}


def simulation(motion: dict[str, Any], **sensors: Any) -> Simulation:
    rig = {"cameras": [CAMERA], "motion": motion, **sensors}
    return Simulation(config_from_mapping({**WORLD, "sensors": rig}))


def samples(motion: dict[str, Any], count: int, seed: int = 5, **sensors: Any) -> list[Sample]:
    made = simulation(motion, **sensors)
    made.step_batch(seed=seed)
    return [made.step_sample() for _ in range(count)]


def places(taken: Sequence[Sample]) -> FloatArray:
    return np.array([sample.rig_pose.position_m for sample in taken])


def axes(taken: Sequence[Sample]) -> FloatArray:
    return np.array([pose_to_matrix(sample.rig_pose)[:3, :3] for sample in taken])


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_a_restored_rig_goes_on_as_it_would_have(motion: dict[str, Any]) -> None:
    made = simulation(motion)
    made.step_batch(seed=9)
    poses, state = [], {}
    for index in range(4):
        if index == 2:
            state = json.loads(json.dumps(made.state()))
        poses.append(made.step_sample().rig_pose)
    again = simulation(motion)
    again.restore(state)
    assert [again.step_sample().rig_pose for _ in range(2)] == poses[2:]
    assert len(set(poses)) == 4


@pytest.mark.parametrize("name", ["random", "hover", "around", "look_at"])
def test_another_seed_is_another_way(name: str) -> None:
    first, same, other = (places(samples(MOTIONS[name], 3, seed)) for seed in (5, 5, 6))
    assert (first == same).all()
    assert (first != other).any()


def test_random_poses_fill_their_ranges() -> None:
    motion = {"kind": "random", "position_m": BOX, "roll_deg": [-10, 10], "pitch_deg": [20, 40]}
    taken = samples({**motion, "yaw_deg": [90, 100]}, 60)
    low, high = np.array(BOX).T
    assert ((places(taken) >= low) & (places(taken) <= high)).all()
    assert (np.ptp(places(taken), axis=0) > 0.7 * (high - low)).all()
    # Fixed axes in the order roll, pitch, yaw: forward is (cos p cos y, cos p sin y, -sin p).
    forward = axes(taken)[:, :, 0]
    pitch_deg = np.rad2deg(np.arcsin(-forward[:, 2]))
    yaw_deg = np.rad2deg(np.arctan2(forward[:, 1], forward[:, 0]))
    assert pitch_deg.min() > 20
    assert pitch_deg.max() < 40
    assert np.ptp(pitch_deg) > 10
    assert yaw_deg.min() > 90
    assert yaw_deg.max() < 100


def test_hovering_follows_the_ground() -> None:
    made = simulation({"kind": "hover", "height_above_ground_m": 2.5, "yaw_deg": 0})
    made.step_batch(seed=5)
    taken = [made.step_sample() for _ in range(20)]
    ground_m = made.query_height(places(taken)).ground_height_m
    np.testing.assert_allclose(places(taken)[:, 2], ground_m + 2.5, atol=1e-9)
    np.testing.assert_allclose(axes(taken)[:, :, 0], [(0, 0, -1)] * 20, atol=1e-12)
    np.testing.assert_allclose(axes(taken)[:, :, 2], [(1, 0, 0)] * 20, atol=1e-12)
    assert np.abs(places(taken)[:, :2]).max() < 18


def test_hovering_too_low_is_lifted_to_the_least_clearance() -> None:
    made = simulation({"kind": "hover", "height_above_ground_m": 0.1}, min_clearance_m=0.8)
    made.step_batch(seed=5)
    taken = [made.step_sample() for _ in range(5)]
    clearance_m = made.query_height(places(taken)).clearance_m
    np.testing.assert_allclose(clearance_m, 0.8, atol=1e-9)


def test_a_rig_around_a_target_looks_at_it_from_a_shell() -> None:
    motion = {
        "kind": "around_target",
        "target_m": [1, 2, 8],
        "distance_m": [4, 6],
        "elevation_deg": [30, 60],
        "azimuth_deg": [0, 90],
    }
    taken = samples(motion, 30)
    away_m = places(taken) - (1, 2, 8)
    distance_m = np.linalg.norm(away_m, axis=1)
    elevation_deg = np.rad2deg(np.arcsin(away_m[:, 2] / distance_m))
    azimuth_deg = np.rad2deg(np.arctan2(away_m[:, 1], away_m[:, 0]))
    for values, (least, most) in (
        (distance_m, (4, 6)), (elevation_deg, (30, 60)), (azimuth_deg, (0, 90))
    ):  # fmt: skip
        assert values.min() >= least
        assert values.max() <= most
        assert np.ptp(values) > 0.6 * (most - least)
    np.testing.assert_allclose(axes(taken)[:, :, 0], -away_m / distance_m[:, None], atol=1e-9)
    np.testing.assert_allclose(axes(taken)[:, 2, 1], 0, atol=1e-9, err_msg="level")


def test_a_target_may_be_an_object() -> None:
    motion = {"kind": "around_target", "target_instance": 1, "distance_m": 5}
    for sample in samples(motion, 4):
        instance = sample.frame("camera", "instance").data
        assert (instance[5:7, 7:9] == 1).all(), "the sphere is in the image's middle"
        depth_m = sample.frame("camera", "depth").data
        assert 4.5 < depth_m.min() < 4.6


def test_an_object_that_does_not_exist_is_no_target() -> None:
    with pytest.raises(InvalidInputError, match="target_instance: received 77"):
        samples({"kind": "around_target", "target_instance": 77}, 1)


def test_an_approach_leads_straight_in() -> None:
    motion = {
        "kind": "around_target",
        "target_m": [0, 0, 6],
        "distance_m": [9, 12],
        "redraw": "batch",
        "approach": {"distance_m": 2, "steps": 4},
    }
    way_m = places(samples(motion, 5)) - (0, 0, 6)
    distance_m = np.linalg.norm(way_m, axis=1)
    np.testing.assert_allclose(distance_m, np.append(np.linspace(distance_m[0], 2, 4), 2))
    np.testing.assert_allclose(way_m / distance_m[:, None], [way_m[0] / distance_m[0]] * 5)


def test_a_target_may_be_an_offset_on_the_ground() -> None:
    motion = {
        "kind": "look_at",
        "position_m": BOX,
        "height_above_ground_m": 1.5,
        "target_m": [[3, 4], 0, 0],
        "target_is_offset": True,
        "target_above_ground_m": 0,
    }
    made = simulation(motion)
    made.step_batch(seed=5)
    for _ in range(4):
        pose = made.step_sample().rig_pose
        forward = pose_to_matrix(pose)[:3, 0]
        assert forward[1] == pytest.approx(0, abs=1e-12)
        reach_m = np.array([[pose.position_m[0] + t, pose.position_m[1], 0] for t in (3, 4)])
        ground_m = made.query_height(reach_m).ground_height_m
        slopes = (ground_m - pose.position_m[2]) / (3, 4)
        assert slopes.min() - 0.1 < forward[2] / forward[0] < slopes.max() + 0.1


def test_looking_straight_down_at_a_target_has_the_image_upright() -> None:
    (sample,) = samples({"kind": "look_at", "position_m": [1, 2, 9], "target_m": [1, 2, 0]}, 1)
    np.testing.assert_allclose(axes([sample])[0][:, 0], (0, 0, -1), atol=1e-9)
    np.testing.assert_allclose(axes([sample])[0][:, 2], (1, 0, 0), atol=1e-9)


def test_a_grid_goes_to_and_fro_over_the_stage() -> None:
    made = simulation({"kind": "grid", "columns": 3, "rows": 2, "altitude_m": 6, "overlap": 0.25})
    made.step_batch(seed=5)
    way_m = places([made.step_sample() for _ in range(7)])
    # An image is 16 / 13.5 x 6 m wide and 12 / 13.5 x 6 m high; three quarters of that are new.
    x, y = 16 / 13.5 * 6 * 0.75, 12 / 13.5 * 6 * 0.75 / 2
    expected = [(-x, y), (0, y), (x, y), (x, -y), (0, -y), (-x, -y), (-x, y)]
    np.testing.assert_allclose(way_m[:, :2], expected, atol=1e-9)
    heights = made.query_height(way_m)
    np.testing.assert_allclose(way_m[:, 2], heights.ground_height_m + 6, atol=1e-9)


def test_a_grid_points_the_camera_down_however_it_is_mounted() -> None:
    quat = Rotation.from_euler("xyz", (20, -30, 70), degrees=True).as_quat().tolist()
    camera = {**CAMERA, "mount_position_m": [0.4, 0.2, -0.3], "mount_quat_xyzw": quat}
    (sample,) = samples({"kind": "grid", "columns": 1, "rows": 1}, 1, cameras=[camera])
    T_map_camera = sample.frame("camera", "depth").T_map_camera
    np.testing.assert_allclose(T_map_camera[:3, 2], (0, 0, -1), atol=1e-9)
    np.testing.assert_allclose(T_map_camera[:3, 0], (1, 0, 0), atol=1e-9)
    np.testing.assert_allclose(T_map_camera[:2, 3], 0, atol=1e-9)


def test_a_spline_goes_through_its_waypoints_at_one_speed() -> None:
    waypoints_m = [[-5, 0, 7], [0, 4, 8], [6, 0, 7], [2, -6, 8]]
    motion = {"kind": "spline", "waypoints_m": waypoints_m, "step_m": 0.1, "is_closed": True}
    way_m = places(samples(motion, 310))
    apart_m = np.linalg.norm(np.diff(way_m, axis=0), axis=1)
    np.testing.assert_allclose(apart_m, 0.1, rtol=2e-3)
    for waypoint_m in waypoints_m:
        assert np.linalg.norm(way_m - waypoint_m, axis=1).min() < 0.055
    bends = np.diff(np.diff(way_m, axis=0), axis=0)
    assert np.linalg.norm(bends, axis=1).max() < 0.012, "there is no corner, nor where it closes"


def test_a_spline_may_look_along_itself_or_down_or_as_told() -> None:
    straight = {"kind": "spline", "waypoints_m": [[-4, -4, 8], [4, 4, 8]], "step_m": 2}
    forward = axes(samples(straight, 2))
    np.testing.assert_allclose(forward[:, :, 0], [(0.5**0.5, 0.5**0.5, 0)] * 2, atol=1e-9)
    down = axes(samples({**straight, "look": "down"}, 2))
    np.testing.assert_allclose(down[:, :, 0], [(0, 0, -1)] * 2, atol=1e-9)
    np.testing.assert_allclose(down[:, :, 2], [(0.5**0.5, 0.5**0.5, 0)] * 2, atol=1e-9)
    turned = Rotation.from_euler("z", [[0], [90]], degrees=True).as_quat().tolist()
    told = samples({**straight, "quats_xyzw": turned, "step_m": 128**0.5 / 2}, 3)
    yaw_deg = Rotation.from_matrix(axes(told)).as_euler("xyz", degrees=True)[:, 2]
    np.testing.assert_allclose(yaw_deg, (0, 45, 90), atol=1e-6)


def poses_file(folder: Path, lines: Sequence[str]) -> Path:
    path = folder / "poses.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_poses_come_from_a_file_beside_the_configuration(tmp_path: Path) -> None:
    header = "sample_id,x_m,y_m,z_m,qx,qy,qz,qw"
    poses_file(tmp_path, [header, "1,1,2,9,0,0,0,1", "2,3,2,9,0,0,1,0"])
    config = tmp_path / "world.yaml"
    motion = {"kind": "csv", "path": "poses.csv", "offset_m": [0, 0, 1]}
    config.write_text(json.dumps({**WORLD, "sensors": {"cameras": [CAMERA], "motion": motion}}))
    made = Simulation(load_config(config))
    made.step_batch()
    assert made.step_sample().rig_pose == Pose((1, 2, 10), (0, 0, 0, 1))
    assert made.step_sample().rig_pose == Pose((3, 2, 10), (0, 0, 1, 0))
    with pytest.raises(InvalidInputError, match=r"step 3.*one of the 2 poses"):
        made.step_sample()
    made.step_sample(ModuleMetadata(sensor={"pose": pose_looking_down(0, 0, 9)}))


def test_a_file_without_a_header_has_its_columns_named(tmp_path: Path) -> None:
    path = poses_file(tmp_path, ["1,1,2,9,1,0,0,0", "2,3,2,9,0,0,0,1"])
    columns = ["sample_id", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"]
    motion = {"kind": "csv", "path": str(path), "columns": columns, "at_end": "repeat"}
    taken = samples(motion, 3)
    assert taken[0].rig_pose == Pose((1, 2, 9), (0, 0, 0, 1)) == taken[2].rig_pose
    assert taken[1].rig_pose == Pose((3, 2, 9), (0, 0, 1, 0))


def test_the_rig_may_stay_for_several_samples() -> None:
    way_m = places(samples({**MOTIONS["random"], "step_interval": 3}, 7))
    assert (way_m[0] == way_m[1]).all()
    assert (way_m[1] == way_m[2]).all()
    assert (way_m[3] != way_m[2]).all()
    assert (way_m[3] == way_m[5]).all()
    stepwise = places(samples(MOTIONS["random"], 3))
    np.testing.assert_array_equal(way_m[::3], stepwise)


def test_refused_poses_are_drawn_again_until_none_is_left() -> None:
    half_inside = {"kind": "random", "position_m": [[10, 30], 0, 12]}
    assert places(samples(half_inside, 12))[:, 0].max() < 20
    with pytest.raises(InvalidInputError, match=r"sensors.motion.*64 draws.*off the stage"):
        samples({"kind": "random", "position_m": [[25, 30], 0, 12]}, 1)
    below = {"kind": "spline", "waypoints_m": [[0, 0, -20], [1, 0, -20]]}
    with pytest.raises(InvalidInputError, match=r"sensors.motion.*its only pose.*under"):
        samples(below, 1)
    assert places(samples(below, 1, pose_policy="allow"))[0, 2] == -20


def test_a_pose_that_is_given_goes_before_the_motion_for_that_sample() -> None:
    undisturbed = places(samples(MOTIONS["random"], 3))
    made = simulation(MOTIONS["random"])
    made.step_batch(seed=5)
    given = pose_looking_down(1, 1, 9)
    taken = [
        made.step_sample(),
        made.step_sample(ModuleMetadata(sensor={"pose": given})),
        made.step_sample(),
    ]
    assert taken[1].rig_pose == given
    np.testing.assert_array_equal(places(taken)[[0, 2]], undisturbed[[0, 2]])


def test_a_batch_may_have_a_motion_of_its_own() -> None:
    made = simulation({"kind": "given"})
    made.step_batch(ModuleMetadata(sensor={"motion": MOTIONS["hover"]}), seed=5)
    state = json.loads(json.dumps(made.state()))
    taken = [made.step_sample() for _ in range(2)]
    np.testing.assert_array_equal(places(taken), places(samples(MOTIONS["hover"], 2)))
    again = simulation({"kind": "given"})
    again.restore(state)
    assert again.step_sample().rig_pose == taken[0].rig_pose
    made.step_batch(seed=5)
    assert made.step_sample().rig_pose == made.step_sample().rig_pose, "the next one has none"


@pytest.mark.parametrize(
    ("metadata", "field"),
    [
        ({"motion": {"kind": "walk"}}, "metadata.sensor.motion.kind"),
        ({"motion": {"kind": "hover", "speed": 2}}, "metadata.sensor.motion.speed"),
        ({"motion": {"kind": "csv", "path": "no/such.csv"}}, "metadata.sensor.motion.path"),
    ],
    ids=["kind", "key", "file"],
)
def test_motions_that_make_no_sense_are_refused(metadata: dict[str, Any], field: str) -> None:
    with pytest.raises(InvalidInputError) as refused:
        simulation({"kind": "given"}).step_batch(ModuleMetadata(sensor=metadata))
    assert refused.value.field == field


def test_a_motion_is_chosen_for_a_batch_only() -> None:
    made = simulation({"kind": "given"})
    made.step_batch()
    with pytest.raises(InvalidInputError, match=r"metadata\.sensor\.motion"):
        made.step_sample(ModuleMetadata(sensor={"motion": MOTIONS["hover"]}))


@pytest.mark.parametrize(
    "motion",
    [
        {"kind": "random", "position_m": [[1, 0], 0, 0]},
        {"kind": "around_target", "elevation_deg": 90},
        {"kind": "around_target", "approach": {"distance_m": 1}},
        {"kind": "spline", "waypoints_m": [[0, 0, 1], [0, 0, 1]]},
        {"kind": "spline", "waypoints_m": [[0, 0, 1], [0, 0, 2]], "quats_xyzw": [[0, 0, 0, 1]]},
        {"kind": "grid", "camera": "other"},
        {"kind": "hover", "height_above_ground_m": [-1, 1]},
    ],
    ids=str,
)
def test_a_configuration_of_no_sense_is_refused(motion: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="motion"):
        config_from_mapping({**WORLD, "sensors": {"motion": motion}})
