"""The files of a live page, read by other programs and repeated from what they say."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator

import numpy as np
import pytest
import yaml
from mcap_ros2.reader import read_ros2_messages
from PIL import Image

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import OaisysError
from oaisys_core.geometry import pose_looking_at
from oaisys_core.output.poses import read_poses
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, Pose, Provenance, Sample, SimulatorInfo
from oaisys_ros_bridge.live.bag import LiveBag, mean_twist
from oaisys_ros_bridge.live.outputs import Outputs

WORLD = {
    "backend": "analytic",
    "stage": {"preset": "plane", "extent_m": 40, "resolution_px": 33},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 64, "relief": 0}},
    "assets": {"rocks": []},
    "sensors": {"cameras": [{"width_px": 64, "height_px": 48, "fx_px": 54.0, "fy_px": 54.0}]},
    "render": {"quality": "draft"},
}
POSES = tuple(pose_looking_at((x_m, -4, 4), (0, 0, 0)) for x_m in (-4.0, 4.0))


@pytest.fixture(scope="module")
def simulation() -> Iterator[Simulation]:
    simulation = Simulation(config_from_mapping(WORLD))
    simulation.step_batch()
    yield simulation
    simulation.close()


@pytest.fixture(scope="module")
def samples(simulation: Simulation) -> list[Sample]:
    return [
        simulation.step_sample(ModuleMetadata(sensor={"pose": pose}, environment={"haze": None}))
        for pose in POSES
    ]


def test_a_picture_says_how_to_render_its_bytes_again(simulation, samples, tmp_path):
    outputs = Outputs(tmp_path)
    path = outputs.write_picture(samples[0], samples[0].frame("camera", "rgb"))
    with Image.open(path) as image:
        pixels, record = np.asarray(image), json.loads(image.info["oaisys"])
    how = Provenance(**record["provenance"])
    outline = samples[0].outline
    assert (how, record["rig_pose"]["position_m"]) == (outline.provenance, [-4.0, -4.0, 4.0])
    again = simulation.repeat(outline)
    np.testing.assert_array_equal(again.frame("camera", "rgb").data, pixels)
    assert outputs.write_picture(samples[1], samples[1].frame("camera", "rgb")) != path


def test_poses_are_kept_line_by_line_in_a_file_of_this_session(tmp_path):
    (tmp_path / "survey_0001.csv").write_text("somebody else's")
    outputs = Outputs(tmp_path)
    path, _ = outputs.keep_pose(POSES[0])
    assert outputs.keep_pose(POSES[1]) == (path, 2)
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["x_m"]) for row in rows] == [-4.0, 4.0]
    assert [float(row["qw"]) for row in rows] == [pose.quat_xyzw[3] for pose in POSES]
    assert read_poses(path) == list(POSES)  # as `oaisys render --poses` does
    assert (tmp_path / "survey_0001.csv").read_text() == "somebody else's"


def test_a_file_that_somebody_edits_or_links_costs_one_request(tmp_path):
    """Saved in another encoding, the file of poses ended the page."""
    outputs = Outputs(tmp_path)
    path, _ = outputs.keep_pose(POSES[0])
    path.write_text("x_m\n1.0\n", encoding="utf-16")
    with pytest.raises(OaisysError, match=r"survey_0001.*UTF-16, expected UTF-8"):
        outputs.keep_pose(POSES[1])
    path.unlink()
    assert outputs.keep_pose(POSES[1]) == (path, 1)
    (tmp_path / "bag_0001").symlink_to("elsewhere")
    assert outputs.new_path("bag_", "").name == "bag_0002"


def test_an_exported_configuration_is_valid_and_has_the_changes(tmp_path):
    changes = ModuleMetadata(
        environment={"sun_elevation_deg": 12.0},
        render={"exposure_ev": 1.5},
        custom={"stage": {"preset": "dunes"}},
    )
    path = Outputs(tmp_path).write_config(json.dumps(WORLD), changes, 7)
    config = config_from_mapping(yaml.safe_load(path.read_text()))
    assert config.environment.sun_elevation_deg == (12.0, 12.0)
    assert (config.render.exposure_ev, config.stage.preset) == (1.5, "dunes")
    assert "seed 7" in path.read_text()
    with pytest.raises(OaisysError, match="does not tell its configuration"):
        Outputs(tmp_path).write_config("", changes, 7)


def test_a_bag_holds_each_image_where_it_was_taken(simulation, samples, tmp_path):
    info: SimulatorInfo = simulation.info()
    bag = LiveBag(tmp_path, info)
    for sample in samples:
        bag.write(sample)
    assert ": 2 samples, " in bag.finish()
    (file,) = bag.folder.glob("*.mcap")
    found = [(each.channel.topic, each.ros_msg) for each in read_ros2_messages(str(file))]
    colours = [message for topic, message in found if topic == "/camera/color/image_raw"]
    assert [bytes(each.data) for each in colours] == [
        sample.frame("camera", "rgb").data.tobytes() for sample in samples
    ]
    odometry = [message for topic, message in found if topic == "/ground_truth/odometry"]
    assert [each.pose.pose.position.x for each in odometry] == [-4.0, 4.0]
    assert [each.header.stamp.nanosec for each in odometry] == [
        each.header.stamp.nanosec for each in colours
    ]


def test_twists_are_means_in_the_axes_of_the_later_pose():
    """A quarter turn to the left in half a second, while moving 1 m north."""
    half = float(np.sqrt(0.5))
    before, now = Pose((0, 0, 0), (0, 0, 0, 1)), Pose((0, 1, 0), (0, 0, half, half))
    twist = mean_twist(0, before, 500_000_000, now)
    np.testing.assert_allclose(twist.velocity_m_s, (2.0, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(twist.angular_rate_rad_s, (0.0, 0.0, np.pi), atol=1e-12)
