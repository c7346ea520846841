"""The typed fields of ``~/sample_info``, and samples that were recorded before there were any."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap_ros2.writer import Writer
from rcl_interfaces.msg import ParameterType
from rclpy.parameter import parameter_value_to_python
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Header

from oaisys_core.errors import InvalidInputError
from oaisys_core.sensing.faults import DepthFaults
from oaisys_core.types import Pose, Provenance, Sample
from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.bags.mcap_format.message_definition import SEPARATOR, message_definition
from oaisys_ros_bridge.bags.reading import BagReader
from oaisys_ros_bridge.publishing.sample_info import sample_info_msg

TYPE = "oaisys_msgs/msg/SampleInfo"
FIRST_TYPED = "# The same as render_time"
METADATA = {
    "environment": {"sun_elevation_deg": 12.5, "haze": None, "clouds": {}},
    "asset": {
        "count_factor": 2,
        "add": {"a": {"position_m": [1, 2.5, 3], "levels": [{"name": "x"}, {"name": "y"}]}},
    },
    "render": {"denoise": True, "passes": ["rgb", "depth"], "seed": 2**64 - 1},
}


def told(faults: DepthFaults | None = None, **texts: Any) -> SampleInfo:
    """Return the message of a sample with some JSON texts, after a way over the wire."""
    how = Provenance(1, 2, "a" * 64, "analytic", "0.1.0", "standard", 4)
    jsons: dict[str, Any] = {f"{name}_json": json.dumps(value) for name, value in texts.items()}
    how = replace(how, **jsons)
    sample = Sample(3, 4, Pose((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0)), (), 75.25, how)
    message = sample_info_msg(sample, Header(frame_id="map"), faults)
    return deserialize_message(serialize_message(message), SampleInfo)


def test_metadata_are_parameters_by_the_path_of_their_keys() -> None:
    found = {p.name: parameter_value_to_python(p.value) for p in told(metadata=METADATA).metadata}
    assert found == {
        "environment.sun_elevation_deg": 12.5,
        "environment.haze": None,
        "asset.count_factor": 2,
        "asset.add.a.position_m": [1.0, 2.5, 3.0],
        "asset.add.a.levels[0].name": "x",
        "asset.add.a.levels[1].name": "y",
        "render.denoise": True,
        "render.passes": ["rgb", "depth"],
        "render.seed": float(2**64 - 1),
    }
    kinds = {p.name: p.value.type for p in told(metadata=METADATA).metadata}
    assert kinds["asset.count_factor"] == ParameterType.PARAMETER_INTEGER
    assert kinds["render.denoise"] == ParameterType.PARAMETER_BOOL


def test_durations_exposures_poses_and_faults_are_in_types() -> None:
    message = told(
        DepthFaults(seed=9, noise="quadratic", sigma_m=0.02),
        exposures={"front": -1.5, "left.eye.mono16.exposure_time_s": 0.0125},
        previous_poses={"front": {"position_m": [1, 2, 3.5], "quat_xyzw": [0, 0, 0.6, 0.8]}},
    )
    assert (message.render_duration.sec, message.render_duration.nanosec) == (75, 250_000_000)
    display, digital = message.exposures
    assert (display.sensor, display.modality, display.stops) == ("front", "rgb", -1.5)
    assert (digital.sensor, digital.modality) == ("left.eye", "mono16")
    assert math.isnan(digital.stops)
    assert (digital.exposure_time.sec, digital.exposure_time.nanosec) == (0, 12_500_000)
    (previous,) = message.previous_poses
    assert (previous.sensor, previous.rig_pose.position.z) == ("front", 3.5)
    assert previous.rig_pose.orientation.w == 0.8
    faults = message.faults
    assert (faults.active, faults.seed, faults.noise, faults.sigma_m) == (
        True,
        9,
        "quadratic",
        0.02,
    )
    assert not told().faults.active
    assert (list(told().metadata), list(told().motion.knots)) == ([], [])


def test_a_motion_is_read_by_what_its_definition_says() -> None:
    """Two pieces of x = t³ - 2t, y = 4, z = t² from t = 1 on, about their own first time."""
    begin = (1.0, 3.0)
    positions = np.zeros((4, 2, 3))
    for i, t in enumerate(begin):  # Taylor's coefficients, the highest power first
        positions[:, i, 0] = (1.0, 3 * t, 3 * t**2 - 2, t**3 - 2 * t)
        positions[:, i, 1] = (0.0, 0.0, 0.0, 4.0)
        positions[:, i, 2] = (0.0, 1.0, 2 * t, t**2)
    turns = np.zeros((4, 2, 3))
    turns[2, :, 2] = 0.25
    motion = {
        "knots_s": [*begin, 4.0],
        "positions": positions.tolist(),
        "quats_xyzw": [[0, 0, 0, 1], [0, 0, 0.6, 0.8]],
        "turns": turns.tolist(),
    }
    found = told(motion=motion).motion
    coefficients = np.reshape(found.positions, (4, len(found.orientations), 3))
    for t in (1.0, 1.7, 3.0, 3.9):
        piece = int(np.searchsorted(found.knots, t, side="right")) - 1
        since = t - found.knots[piece]
        x, y, z = (np.polyval(coefficients[:, piece, axis], since) for axis in range(3))
        np.testing.assert_allclose((x, y, z), (t**3 - 2 * t, 4.0, t**2), atol=1e-12)
    assert found.orientations[1].z == 0.6
    np.testing.assert_array_equal(np.reshape(found.turns, (4, 2, 3)), turns)


@pytest.mark.parametrize(
    "texts", [{"metadata": 3}, {"previous_poses": {"a": {}}}, {"exposures": {"a": "bright"}}]
)
def test_damaged_texts_are_refused_by_name(texts: dict[str, Any]) -> None:
    (name,) = texts
    with pytest.raises(InvalidInputError, match=f"provenance.{name}_json"):
        told(**texts)


def test_a_sample_that_was_recorded_before_these_fields_is_read(tmp_path: Path) -> None:
    """The bag's writer is `mcap_ros2`, by the definition as it was."""
    own, *nested = message_definition(TYPE).split(SEPARATOR)
    earlier = own.partition(FIRST_TYPED)[0] + "".join(SEPARATOR + each for each in nested)
    assert "rcl_interfaces/Parameter[] metadata" not in earlier
    quat = {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}
    pose = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": quat}
    sensor = {
        "sensor": "front",
        "modalities": ["depth"],
        "pose": pose,
        "k": [float(i) for i in range(9)],
    }
    values = {"batch_id": 3, "sample_id": 4, "rig_pose": pose, "sensors": [sensor], "seed": 2**63}
    values |= {"header": {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "map"}, "topics": ["/a"]}
    with (tmp_path / "old.mcap").open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef(TYPE, earlier)
        writer.write_message("/oaisys_bridge/sample_info", schema, values)
        writer.finish()
    (message,) = BagReader(tmp_path / "old.mcap").messages(["/oaisys_bridge/sample_info"])
    found = message.deserialize(SampleInfo)
    assert (found.header.stamp.sec, found.batch_id, found.seed) == (7, 3, 2**63)
    assert (found.sensors[0].sensor, list(found.sensors[0].k)) == ("front", sensor["k"])
    assert (found.sensors[0].pose.orientation.z, list(found.topics)) == (0.6, ["/a"])
    assert (list(found.metadata), found.faults.active) == ([], False)
    with pytest.raises(InvalidInputError, match="a message of the type SampleInfo"):
        type(message)(message.topic, message.data[:60], 0, message.schema).deserialize(SampleInfo)
