"""The camera that a live page shows, and its images."""

from __future__ import annotations

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import RGB, Sample, SensorInfo
from oaisys_mapping.report.web_viewer import PosedImages
from oaisys_ros_bridge.live_view.source import images_with_pose


def first_camera(sensors: tuple[SensorInfo, ...]) -> SensorInfo:
    """Return the first camera with colour that the page can show.

    Raises:
        InvalidInputError: There is none.
    """
    for sensor in sensors:
        if RGB in sensor.modalities and not sensor.intrinsics.is_fisheye:
            return sensor
    names = ", ".join(sensor.name for sensor in sensors) or "none"
    raise InvalidInputError("sensors.cameras", names, "one with rgb that is no fisheye")


def images_of(sample: Sample) -> PosedImages:
    """Return the images of a sample of one camera, colour and depth rectified."""
    frames = {frame.modality: frame for frame in sample.frames}
    first = next(iter(frames.values()))
    images = {modality: frame.data for modality, frame in frames.items()}
    name = f"{sample.batch_id}.{sample.sample_id} {first.sensor}"
    return images_with_pose(name, images, first.intrinsics, first.T_map_camera)
