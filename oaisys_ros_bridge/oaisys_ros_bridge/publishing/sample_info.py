"""Messages that describe samples and batches: poses, cameras, and how to render them again."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import fields

from geometry_msgs.msg import Pose as PoseMsg
from std_msgs.msg import Header

from oaisys_core.geometry import pose_from_matrix
from oaisys_core.types import (
    Frame,
    FrameName,
    Pose,
    Provenance,
    Sample,
    SampleOutline,
    SimulatorInfo,
)
from oaisys_msgs.msg import SampleInfo, SensorPose
from oaisys_ros_bridge.conversions import pose_to_msg


def sample_info_msg(
    sample: Sample,
    header: Header,
    faults_json: str = "",
    *,
    sequence: int = 0,
    topics: Collection[str] = (),
) -> SampleInfo:
    """Return the message that describes a sample: its frames, poses and provenance.

    Args:
        sample: A complete sample.
        header: Stamp of the sample, and frame of its poses.
        faults_json: Faults that were added to its depth; empty: none.
        sequence: Its number among all published samples; 0: unknown.
        topics: Full names of the topics on which its messages were published.
    """
    frames: dict[str, list[Frame]] = {}
    for frame in sample.frames:
        frames.setdefault(frame.sensor, []).append(frame)
    how = {field.name: getattr(sample.provenance, field.name) for field in fields(Provenance)}
    return SampleInfo(
        header=header,
        batch_id=sample.batch_id,
        sample_id=sample.sample_id,
        rig_pose=pose_to_msg(sample.rig_pose),
        sensors=[_sensor_pose_msg(sensor, of_it) for sensor, of_it in frames.items()],
        render_time=sample.render_time_s,
        from_cache=sample.from_cache,
        faults_json=faults_json,
        sequence=sequence,
        topics=sorted(topics),
        **how,
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


def _sensor_pose_msg(sensor: str, frames: list[Frame]) -> SensorPose:
    return SensorPose(
        sensor=sensor,
        modalities=[frame.modality for frame in frames],
        pose=pose_to_msg(pose_from_matrix(frames[0].T_map_camera)),
        k=frames[0].intrinsics.K.ravel(),
    )
