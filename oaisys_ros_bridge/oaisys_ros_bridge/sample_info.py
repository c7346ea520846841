"""What is told of samples and batches besides their images: where from, and how to repeat them."""

from __future__ import annotations

from dataclasses import fields

from std_msgs.msg import Header

from oaisys_core.geometry import pose_from_matrix
from oaisys_core.types import Frame, Provenance, Sample, SimulatorInfo
from oaisys_msgs.msg import SampleInfo, SensorPose
from oaisys_ros_bridge.conversions import pose_to_msg


def sample_info_msg(sample: Sample, header: Header) -> SampleInfo:
    """Return the message that says what was rendered, from where, and how to repeat it."""
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
        **how,
    )


def batch_info_msg(info: SimulatorInfo, header: Header) -> SampleInfo:
    """Return the message that says which world stands, before there is a sample of it."""
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
