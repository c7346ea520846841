"""Messages of ``~/sample_info``: what a sample is, as texts and in types; which was the last."""

from __future__ import annotations

import copy
import json
import math
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import asdict, fields
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose as PoseMsg
from geometry_msgs.msg import Quaternion
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from std_msgs.msg import Header

from oaisys_core.errors import InvalidInputError, quote
from oaisys_core.files.documents import parse_json
from oaisys_core.geometry import pose_from_matrix
from oaisys_core.sensing.faults import DepthFaults
from oaisys_core.types import (
    POINTS,
    RGB,
    Frame,
    FrameName,
    LidarScan,
    Pose,
    Provenance,
    Sample,
    SampleOutline,
    SimulatorInfo,
)
from oaisys_msgs.msg import DepthFaults as DepthFaultsMsg
from oaisys_msgs.msg import Exposure, PreviousPose, RigMotion, SampleInfo, SensorPose
from oaisys_msgs.srv import GetNewestSample
from oaisys_ros_bridge.conversions import (
    duration_from_seconds,
    pose_to_msg,
    stamp_from_nanoseconds,
)

EXPOSURE_TIME = "exposure_time_s"
"""Last part of the names of exposures that are times: ``CAMERA.MODALITY.exposure_time_s``."""


class Announcements:
    """Counts the samples that a bridge announces; remembers the newest, and the newest world."""

    def __init__(self) -> None:
        self._newest = GetNewestSample.Response(success=True)

    @property
    def newest(self) -> GetNewestSample.Response:
        """The sample and the world that were announced last; not to be changed."""
        return self._newest

    def begin_batch(self, stamp: Time) -> None:
        """Note that another world is announced, which samples show from a stamp on."""
        newest = copy.copy(self._newest)
        newest.batch_begin = stamp
        self._newest = newest

    def add(self, sample: Sample, stamp: Time) -> int:
        """Note a sample that is about to be announced, and return its number, from 1 on."""
        self._newest = GetNewestSample.Response(
            success=True,
            sequence=self._newest.sequence + 1,
            batch_id=sample.batch_id,
            sample_id=sample.sample_id,
            stamp=stamp,
            published=stamp_from_nanoseconds(time.time_ns()),
            batch_begin=self._newest.batch_begin,
        )
        return int(self._newest.sequence)


def sample_info_msg(
    sample: Sample,
    header: Header,
    faults: DepthFaults | None = None,
    *,
    sequence: int = 0,
    topics: Collection[str] = (),
) -> SampleInfo:
    """Return the message that describes a sample: its frames, poses and provenance.

    Args:
        sample: A complete sample.
        header: Stamp of the sample, and frame of its poses.
        faults: Faults that were added to its depth; None: none.
        sequence: Its number among all published samples; 0: unknown.
        topics: Full names of the topics on which its messages were published.
    """
    faults = faults or DepthFaults()
    frames: dict[str, list[Frame]] = {}
    for frame in sample.frames:
        frames.setdefault(frame.sensor, []).append(frame)
    how = {field.name: getattr(sample.provenance, field.name) for field in fields(Provenance)}
    return SampleInfo(
        header=header,
        batch_id=sample.batch_id,
        sample_id=sample.sample_id,
        rig_pose=pose_to_msg(sample.rig_pose),
        sensors=[
            *(_sensor_pose_msg(sensor, of_it) for sensor, of_it in frames.items()),
            *map(_lidar_pose_msg, sample.scans),
        ],
        render_time=sample.render_time_s,
        render_duration=duration_from_seconds(sample.render_time_s),
        from_cache=sample.from_cache,
        faults_json=json.dumps(asdict(faults)) if faults.active else "",
        sequence=sequence,
        topics=sorted(topics),
        **how,
        **_detail_fields(sample.provenance, faults),
    )


def outline_from_msg(msg: SampleInfo) -> SampleOutline:
    """Return the outline of the sample that a message describes; see `sample_info_msg`."""
    how = {field.name: getattr(msg, field.name) for field in fields(Provenance)}
    names = [FrameName(sensor.sensor, m) for sensor in msg.sensors for m in sensor.modalities]
    return SampleOutline(
        batch_id=msg.batch_id,
        sample_id=msg.sample_id,
        rig_pose=_exact_pose(msg.rig_pose),
        frames=tuple(names),
        provenance=Provenance(**how),
        from_cache=msg.from_cache,
    )


def _exact_pose(msg: PoseMsg) -> Pose:
    """Return the pose of a message bit for bit, without normalising it."""
    p, q = msg.position, msg.orientation
    return Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def batch_info_msg(info: SimulatorInfo, header: Header) -> SampleInfo:
    """Return the message that announces a new world, before there is a sample of it."""
    known = {field.name for field in fields(Provenance)} & {field.name for field in fields(info)}
    return SampleInfo(
        header=header,
        batch_id=info.batch_id,
        **{name: getattr(info, name) for name in known},
    )


def _lidar_pose_msg(scan: LidarScan) -> SensorPose:
    pose = pose_to_msg(pose_from_matrix(scan.T_map_lidar))
    return SensorPose(sensor=scan.sensor, modalities=[POINTS], pose=pose)


def _sensor_pose_msg(sensor: str, frames: list[Frame]) -> SensorPose:
    return SensorPose(
        sensor=sensor,
        modalities=[frame.modality for frame in frames],
        pose=pose_to_msg(pose_from_matrix(frames[0].T_map_camera)),
        k=frames[0].intrinsics.K.ravel(),
    )


def _detail_fields(provenance: Provenance, faults: DepthFaults) -> dict[str, Any]:
    """Return the fields that repeat JSON texts in types, by their names."""
    readers: Mapping[str, Callable[[Mapping[str, Any]], Any]] = {
        "metadata": _metadata,
        "previous_poses": _previous_poses,
        "exposures": _exposures,
        "motion": _motion,
    }
    details = {}
    for name, read in readers.items():
        text = getattr(provenance, f"{name}_json")
        try:
            details[name] = read(parse_json(text) if text else {})
        except (AttributeError, AssertionError, KeyError, TypeError, ValueError) as error:
            expected = f"the JSON of {name.replace('_', ' ')} ({quote(error)})"
            raise InvalidInputError(f"provenance.{name}_json", text[:80], expected) from error
    details["faults"] = DepthFaultsMsg(active=faults.active, **asdict(faults))
    return details


def _metadata(values: Mapping[str, Any]) -> list[Parameter]:
    return [each for key, value in values.items() for each in _parameters(key, value)]


def _parameters(name: str, value: Any) -> Iterator[Parameter]:
    """Yield the values below a name, each with the path of its keys."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _parameters(f"{name}.{key}", inner)
        return
    typed = _parameter_value(value)
    if typed is not None:
        yield Parameter(name=name, value=typed)
        return
    for index, inner in enumerate(value):
        yield from _parameters(f"{name}[{index}]", inner)


def _parameter_value(value: Any) -> ParameterValue | None:
    """Return a value, or a list of one kind of values, in its type; None: a list of others."""
    if value is None:
        return ParameterValue(type=ParameterType.PARAMETER_NOT_SET)
    if isinstance(value, bool):
        return ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=value)
    if isinstance(value, int) and -(1 << 63) <= value < 1 << 63:
        return ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=value)
    if isinstance(value, (int, float)):
        return ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=float(value))
    if isinstance(value, str):
        return ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
    return _parameter_list(value)


def _parameter_list(values: list[Any]) -> ParameterValue | None:
    kinds = {type(each) for each in values}
    if kinds <= {str}:
        array = ParameterType.PARAMETER_STRING_ARRAY
        return ParameterValue(type=array, string_array_value=values)
    if kinds == {bool}:
        return ParameterValue(type=ParameterType.PARAMETER_BOOL_ARRAY, bool_array_value=values)
    if not kinds <= {int, float}:
        return None
    if kinds == {int} and all(-(1 << 63) <= each < 1 << 63 for each in values):
        array = ParameterType.PARAMETER_INTEGER_ARRAY
        return ParameterValue(type=array, integer_array_value=values)
    numbers = [float(each) for each in values]
    return ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=numbers)


def _previous_poses(values: Mapping[str, Any]) -> list[PreviousPose]:
    poses = []
    for sensor, pose in values.items():
        p, q = pose["position_m"], pose["quat_xyzw"]
        rig_pose = pose_to_msg(Pose((p[0], p[1], p[2]), (q[0], q[1], q[2], q[3])))
        poses.append(PreviousPose(sensor=sensor, rig_pose=rig_pose))
    return poses


def _exposures(values: Mapping[str, Any]) -> list[Exposure]:
    """Return the exposures of images; see `EXPOSURE_TIME` for those that are times."""
    found = []
    for name, value in values.items():
        image, _, last = name.rpartition(".")
        if last == EXPOSURE_TIME:
            sensor, _, modality = image.rpartition(".")
            time = duration_from_seconds(value)
            each = Exposure(sensor=sensor, modality=modality, stops=math.nan, exposure_time=time)
        else:
            each = Exposure(sensor=name, modality=RGB, stops=float(value))
        found.append(each)
    return found


def _motion(motion: Mapping[str, Any]) -> RigMotion:
    if not motion:
        return RigMotion()
    return RigMotion(
        knots=[float(each) for each in motion["knots_s"]],
        orientations=[
            Quaternion(x=float(x), y=float(y), z=float(z), w=float(w))
            for x, y, z, w in motion["quats_xyzw"]
        ],
        positions=_flat(motion["positions"]),
        turns=_flat(motion["turns"]),
    )


def _flat(coefficients: Any) -> list[float]:
    """Return the numbers of (4, N, 3) nested lists, the last index first."""
    return [float(each) for power in coefficients for piece in power for each in piece]
