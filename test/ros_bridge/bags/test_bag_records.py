"""A bag alone renders its samples again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from commands import oaisys_here
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import Header, String
from synthetic_worlds import SMALL_MATERIALS

from oaisys_core.config import canonical_json, config_from_mapping
from oaisys_core.sensing.faults import CaptureId, DepthFaults, measure_frame
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, Sample
from oaisys_ros_bridge.bags.recorded.recorded_samples import open_bag
from oaisys_ros_bridge.bags.writing import BagWriter, RecordedTopic, qos_entry
from oaisys_ros_bridge.conversions import image_to_msg
from oaisys_ros_bridge.publishing.sample_info import outline_from_msg, sample_info_msg
from oaisys_ros_bridge.topic_names import TOPIC_BY_MODALITY, encoding_of

MODALITIES = ["rgb", "depth", "range", "semantic_0", "instance", "normal"]
CAMERA = {"width_px": 24, "height_px": 18, "fx_px": 20.0, "fy_px": 20.0, "modalities": MODALITIES}
NODE = "/robot/oaisys_bridge"
FAULTS = DepthFaults(seed=3, noise="kinect", missing_ratio=0.1)


class Recorded:
    """A bag as the recorder writes it of a bridge in the namespace ``/robot``."""

    is_bigendian = False
    """Whether images have the highest byte of a value first."""

    def __init__(self, folder: Path, cameras: list[dict[str, Any]]) -> None:
        world = {
            "backend": "analytic",
            "stage": {"resolution_px": 65, "extent_m": 30.0, "surroundings": "plain"},
        }
        world |= {"materials": SMALL_MATERIALS, "assets": {"rocks": [{"count": [8, 8]}]}}
        self.config = config_from_mapping({**world, "sensors": {"cameras": cameras}})
        self.prefixes = {c["name"]: c["name"] if len(cameras) > 1 else "camera" for c in cameras}
        self.simulation = Simulation(self.config)
        self.bag = BagWriter(folder)
        self._at_ns = 0

    def write(self, name: str, kind: str, message: Any) -> None:
        qos = (qos_entry(depth=5, reliable=True, transient_local=False),)
        self.bag.add_topic(RecordedTopic(name, kind, qos))
        self._at_ns += 1000
        self.bag.write(name, serialize_message(message), self._at_ns, self._at_ns)

    def configuration(self) -> None:
        told = String(data=canonical_json(self.config))
        self.write(f"{NODE}/configuration", "std_msgs/msg/String", told)

    def sample(self, sample: Sample, faults: DepthFaults | None = None, first: int = 0) -> None:
        """Record a sample; ``first`` counts its images that are missing."""
        stamp = Time(sec=sample.batch_id, nanosec=sample.sample_id)
        header = Header(stamp=stamp, frame_id="map")
        told = sample_info_msg(sample, header, faults)
        # What comes by other topics may be recorded in any order.
        self.write(f"{NODE}/sample_info", "oaisys_msgs/msg/SampleInfo", told)
        assert outline_from_msg(told) == sample.outline
        for frame in sample.frames[first:]:
            capture = CaptureId(sample.batch_id, sample.sample_id, frame.sensor)
            seen = measure_frame(frame, faults or DepthFaults(), capture)
            image = image_to_msg(seen.data, encoding_of(frame), header)
            if self.is_bigendian:
                turn_bytes(image, seen.data.itemsize)
            topic = TOPIC_BY_MODALITY.get(frame.modality, frame.modality)
            name = f"/robot/{self.prefixes[frame.sensor]}/{topic}/image_raw"
            self.write(name, "sensor_msgs/msg/Image", image)


def repeat(capfd: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    """Repeat a bag; return the exit code and what was printed."""
    ended = oaisys_here("repeat", *arguments)
    return ended.returncode, capfd.readouterr().out


def turn_bytes(image: Image, value_bytes: int) -> None:
    """Turn the order of an image's bytes, which a machine of little endian made."""
    data = bytes(image.data)
    values = [data[at : at + value_bytes][::-1] for at in range(0, len(data), value_bytes)]
    image.data, image.is_bigendian = b"".join(values), 1


@pytest.mark.parametrize("is_bigendian", [False, True])
def test_digital_numbers_are_read_from_a_bag_in_any_order_of_bytes(
    tmp_path: Path, is_bigendian: bool
) -> None:
    """Digital numbers could not be recorded; the bytes of the other order were swapped."""
    modalities = ["mono16", "rgb16", "bayer_grbg16", "radiance", "depth", "instance"]
    recorded = Recorded(tmp_path / "bag", [{"name": "front", **CAMERA, "modalities": modalities}])
    recorded.is_bigendian = is_bigendian
    recorded.simulation.step_batch()
    sample = recorded.simulation.step_sample()
    with recorded.bag:
        recorded.sample(sample)
    bag = open_bag(tmp_path / "bag")
    assert bag is not None
    (found,) = bag.read(bag.ids())
    assert {frame.modality for frame in found.frames} == {*modalities}
    for frame in found.frames:
        np.testing.assert_array_equal(frame.data, sample.frame("front", frame.modality).data)


@pytest.mark.long
def test_a_bag_repeats_all_of_its_samples_noise_included(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    recorded = Recorded(tmp_path / "bag", [{"name": "left", **CAMERA}, {"name": "right", **CAMERA}])
    with recorded.bag:
        recorded.configuration()
        sim = recorded.simulation
        sim.step_batch(ModuleMetadata(asset={"count_factor": 0.5}))
        recorded.sample(sim.step_sample())
        dusk = ModuleMetadata(environment={"sun_elevation_deg": 8})
        recorded.sample(sim.step_sample(dusk), FAULTS)
        sim.step_batch(reuse_stage=True)
        recorded.sample(sim.step_sample(modalities=["depth", "instance"]), first=1)
    code, told = repeat(capfd, tmp_path / "bag", "--all")
    assert code == 0, told
    heads = [line for line in told.splitlines() if line.startswith("batch")]
    assert heads == [f"batch {b} sample {s}: equal" for b, s in ((1, 1), (1, 2), (2, 1))]
    assert told.count(": equal, 432 pixels") == 12 + 12 + 3
    assert "left/depth: not in the record" in told


@pytest.mark.long
def test_a_bag_without_a_configuration_needs_one(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    recorded = Recorded(tmp_path / "bag", [{"name": "front", **CAMERA}])
    with recorded.bag:
        recorded.simulation.step_batch()
        sample = recorded.simulation.step_sample()
        recorded.sample(sample)
        sample = recorded.simulation.step_sample()
        recorded.sample(sample, FAULTS)
    (file,) = (tmp_path / "bag").glob("*.mcap")
    refused = oaisys_here("repeat", file)
    assert refused.returncode == 2
    assert "--config FILE" in refused.stderr
    assert "oaisys_bridge/configuration is recorded" in refused.stderr
    config = tmp_path / "config.yaml"
    config.write_text(canonical_json(recorded.config))
    samples = ("--sample", "1/2", "--sample", "1/1")
    code, told = repeat(capfd, file, "--config", config, *samples)
    assert code == 0, told
    assert "batch 1 sample 2: equal" in told


def test_a_bag_without_samples_is_told_which_topics_to_record(tmp_path: Path) -> None:
    """It said only that there is no such topic."""
    recorded = Recorded(tmp_path / "bag", [{"name": "front", **CAMERA}])
    with recorded.bag:
        recorded.configuration()
    refused = oaisys_here("repeat", tmp_path / "bag")
    assert refused.returncode == 2
    assert "a bag with one topic oaisys_bridge/sample_info, not 0" in refused.stderr
    needed = "--topic oaisys_bridge/sample_info --topic oaisys_bridge/configuration"
    assert needed in " ".join(refused.stderr.split())


@pytest.mark.long
def test_a_pixel_that_differs_in_a_bag_is_told(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    recorded = Recorded(tmp_path / "bag", [{"name": "front", **CAMERA}])
    with recorded.bag:
        recorded.configuration()
        recorded.simulation.step_batch()
        sample = recorded.simulation.step_sample()
        depth = sample.frame("front", "depth").data
        depth.flags.writeable = True
        depth[5, 5] += 0.25
        recorded.sample(sample)
    code, told = repeat(capfd, tmp_path / "bag")
    assert code == 1
    assert "front/depth: 1 of 432 pixels differ" in told


@pytest.mark.parametrize("text", ["{", '{"loudness": 3}'])
def test_faults_that_no_bridge_tells_are_refused(tmp_path: Path, text: str) -> None:
    recorded = Recorded(tmp_path / "bag", [{"name": "front", **CAMERA}])
    with recorded.bag:
        recorded.configuration()
        recorded.simulation.step_batch()
        told = sample_info_msg(recorded.simulation.step_sample(), Header())
        told.faults_json = text
        recorded.write(f"{NODE}/sample_info", "oaisys_msgs/msg/SampleInfo", told)
    done = oaisys_here("repeat", tmp_path / "bag")
    assert done.returncode == 2
    assert "faults_json" in done.stderr
