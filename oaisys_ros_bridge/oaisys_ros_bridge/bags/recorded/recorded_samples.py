"""The samples in a bag, for `oaisys repeat`: their ``~/sample_info`` and their images."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import Image
from std_msgs.msg import String

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import parse_json
from oaisys_core.geometry import pose_to_matrix
from oaisys_core.sensing.faults import CaptureId, DepthFaults, measure_frame
from oaisys_core.types import (
    Frame,
    FrameName,
    PinholeIntrinsics,
    RecordedSample,
    SampleOutline,
    modality_spec,
)
from oaisys_msgs.msg import SampleInfo, SensorPose
from oaisys_ros_bridge import ros_loading  # noqa: F401  # before what loads rclpy
from oaisys_ros_bridge.bags.reading import BagReader
from oaisys_ros_bridge.conversions import image_from_msg, pose_from_msg
from oaisys_ros_bridge.publishing.sample_info import outline_from_msg
from oaisys_ros_bridge.subscribing.sample_watch import camera_poses
from oaisys_ros_bridge.topic_names import TOPIC_BY_MODALITY

SAMPLE_INFO, CONFIGURATION = "sample_info", "configuration"
ONLY_CAMERA = "camera"
"""The topic prefix of a rig's only camera, whatever its own name."""

NEEDED_TOPICS = (
    "everything, or --topic oaisys_bridge/sample_info --topic oaisys_bridge/configuration beside "
    "the images"
)
"""What `oaisys record` must record so that a bag can be repeated."""

SampleId = tuple[int, int]


def open_bag(path: Path) -> BagSamples | None:
    """Return the samples of a bag; None where ``path`` is no bag.

    Raises:
        InvalidInputError: The bag does not hold the samples of exactly one bridge.
    """
    if path.suffix != ".mcap" and not (path.is_dir() and any(path.glob("*.mcap"))):
        return None
    reader = BagReader(path)
    infos = [
        topic.name
        for topic in reader.topics.values()
        if topic.type_name == "oaisys_msgs/msg/SampleInfo" and topic.name.endswith(SAMPLE_INFO)
    ]
    if len(infos) != 1:
        expected = f"a bag with one topic oaisys_bridge/sample_info, not {len(infos)}"
        if not infos:
            expected += f": record {NEEDED_TOPICS}"
        raise InvalidInputError("record", str(path), expected)
    return BagSamples(reader, infos[0])


class BagSamples:
    """The samples that one bridge published.

    Args:
        reader: Of the bag.
        topic: The bridge's ``~/sample_info``.
    """

    def __init__(self, reader: BagReader, topic: str) -> None:
        self._reader = reader
        self._node, _, _ = topic.rpartition("/")
        self._prefix = self._node.rpartition("/")[0]
        self._infos: dict[SampleId, SampleInfo] = {}
        for message in reader.messages([topic]):
            info = message.deserialize(SampleInfo)
            number = (info.batch_id, info.sample_id)
            self._infos.pop(number, None)  # of an earlier run: the newest counts
            self._infos[number] = info

    def config_json(self) -> str | None:
        """Return the configuration of the newest sample; None where the bag does not hold it."""
        topic = f"{self._node}/{CONFIGURATION}"
        if topic not in self._reader.topics or not self._infos:
            return None
        wanted = list(self._infos.values())[-1].config_sha256
        for message in self._reader.messages([topic]):
            text: str = message.deserialize(String).data
            if hashlib.sha256(text.encode()).hexdigest() == wanted:
                return text
        return None

    def ids(self) -> Sequence[SampleId]:
        """Return batch and sample id of the samples, the newest last."""
        return list(self._infos)

    def read(self, wanted: Collection[SampleId]) -> Iterator[RecordedSample]:
        """Yield samples, each when its last image has been read."""
        pending = {
            _stamp(info): _PartialSample(info) for n, info in self._infos.items() if n in wanted
        }
        names = {
            self._topic(sensor.sensor, modality): FrameName(sensor.sensor, modality)
            for sample in pending.values()
            for sensor in camera_poses(sample.info)
            for modality in sensor.modalities
        }
        for message in self._reader.messages(set(names) & self._reader.topics.keys()):
            # The message begins with 4 bytes of CDR header, then the stamp.
            sample = pending.get(struct.unpack_from("<iI", message.data, 4))
            if sample is None:
                continue
            image = message.deserialize(Image)
            sample.images[names[message.topic]] = image_from_msg(image)
            if sample.is_complete:
                yield pending.pop(_stamp(sample.info)).record()
        for sample in pending.values():
            yield sample.record()

    def _topic(self, sensor: str, modality: str) -> str:
        """Return the topic of a sensor's images; see `ONLY_CAMERA`."""
        image = f"{TOPIC_BY_MODALITY.get(modality, modality)}/image_raw"
        own = f"{self._prefix}/{sensor}/{image}"
        return own if own in self._reader.topics else f"{self._prefix}/{ONLY_CAMERA}/{image}"


@dataclass
class _PartialSample:
    """A sample some of whose images have been read."""

    info: SampleInfo
    images: dict[FrameName, NDArray[np.generic]] = field(default_factory=dict)

    @property
    def is_complete(self) -> bool:
        return len(self.images) == sum(len(s.modalities) for s in camera_poses(self.info))

    def record(self) -> RecordedSample:
        outline = outline_from_msg(self.info)
        sensors = {sensor.sensor: sensor for sensor in self.info.sensors}
        frames = tuple(
            _frame(name, self.images[name], sensors[name.sensor])
            for name in outline.frames
            if name in self.images
        )
        faults = _faults(self.info.faults_json)
        return RecordedSample(
            outline,
            frames,
            lambda frame: measure_frame(frame, faults, _capture(outline, frame)),
        )


def _capture(outline: SampleOutline, frame: Frame) -> CaptureId:
    return CaptureId(outline.batch_id, outline.sample_id, frame.sensor)


def _frame(name: FrameName, data: NDArray[np.generic], sensor: SensorPose) -> Frame:
    """Return a frame as it was rendered: with unsigned ids, and without distortion."""
    height, width = data.shape[:2]
    K = np.asarray(sensor.k).reshape(3, 3)
    camera = PinholeIntrinsics(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    spec = modality_spec(name.modality)
    pixels = data.view(spec.dtype) if data.dtype.itemsize == spec.dtype.itemsize else data
    T_map_camera = pose_to_matrix(pose_from_msg(sensor.pose))
    return Frame(name.sensor, name.modality, pixels, camera, T_map_camera)


def _faults(text: str) -> DepthFaults:
    try:
        values: Mapping[str, object] = parse_json(text) if text else {}
        return DepthFaults(**values)  # type: ignore[arg-type] # a wrong name raises TypeError
    except (TypeError, ValueError) as error:
        expected = f"the depth faults of a bridge ({error})"
        raise InvalidInputError("sample_info.faults_json", text, expected) from error


def _stamp(info: SampleInfo) -> tuple[int, int]:
    return (info.header.stamp.sec, info.header.stamp.nanosec)
