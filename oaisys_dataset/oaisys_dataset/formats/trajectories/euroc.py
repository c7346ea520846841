"""EuRoC (ASL): a folder ``mav0`` for each world, with every camera's images and calibration."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import invert, pose_from_matrix
from oaisys_core.output.images import encode_image
from oaisys_core.types import DEPTH, RGB, FloatArray
from oaisys_dataset.formats.base import (
    DatasetFormat,
    ExportOptions,
    FormatConventions,
    write_file,
)
from oaisys_dataset.formats.trajectories.sequences import (
    CameraSequence,
    camera_sequences,
    numbers,
    rate_hz,
    write_lines,
)
from oaisys_dataset.records import world_name
from oaisys_dataset.shards import read_pixels

if TYPE_CHECKING:
    from oaisys_dataset.manifest import FrameRecord
    from oaisys_dataset.reader import Dataset

RIGID_M = 1e-6
"""Largest change of an entry of ``T_body_camera`` for which cameras count as rigidly mounted."""

FOLDERS = {RGB: "cam", DEPTH: "depth"}
TRUTH = "state_groundtruth_estimate0"

CONVENTIONS = FormatConventions(
    layout="""\
`world_000012/mav0/` holds a world. Cameras are numbered in the order of the manifest.

| file | holds |
|---|---|
| `cam0/data/NANOSECONDS.png`, `cam0/data.csv` | colour, and the stamp and file of each image |
| `cam0/sensor.yaml` | size, intrinsics, distortion, and `T_BS`, the camera's pose in the body |
| `depth0/data/NANOSECONDS.exr`, `depth0/data.csv`, `depth0/sensor.yaml` | the depth that belongs \
to `cam0`; an addition to the format |
| `state_groundtruth_estimate0/data.csv` | position and quaternion (w, x, y, z) of the body |

Stamps are nanoseconds of simulated time since the world's first view.""",
    reading="""\
```python
from evo.tools import file_interface

file = "world_000000/mav0/state_groundtruth_estimate0/data.csv"
trajectory = file_interface.read_euroc_csv_trajectory(file)
```""",
    poses="the *body* is the frame of `cam0`, so that its `T_BS` is the identity. The ground truth "
    "takes points from the body to `map`, and `T_BS` from a camera to the body. The columns of "
    "velocities and IMU biases are left out, because views need not be a motion in time",
    labels="not in this format",
)


class EurocFormat(DatasetFormat):
    """Colour, depth, calibration and trajectory of a rig, as in the EuRoC data sets."""

    name = "euroc"
    modalities = (RGB,)
    images_beside = (RGB, DEPTH)
    conventions = CONVENTIONS

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        counts: Counter[str] = Counter()
        for world, cameras in camera_sequences(dataset.records):
            folder = target / world_name(world) / "mav0"
            mounts = [_mount(cameras[0], camera) for camera in cameras]
            _write_truth(folder / TRUTH, cameras, mounts)
            for number, (camera, mount) in enumerate(zip(cameras, mounts, strict=True)):
                _write_sensors(folder, number, camera, mount)
                for record in camera.records:
                    files = dataset.files(record)
                    if DEPTH in files:
                        depth_m = read_pixels(files[DEPTH], DEPTH, record.images[DEPTH].file)
                        files[DEPTH] = encode_image(depth_m)
                    for modality in FOLDERS.keys() & files.keys():
                        write_file(folder, _file(modality, number, record), files[modality])
                    counts["frames"] += 1
                    options.progress(counts["frames"])
            counts["worlds"] += 1
        return counts


def _mount(body: CameraSequence, camera: CameraSequence) -> FloatArray:
    """Return the pose of a camera in the frame of the rig's first one.

    Raises:
        InvalidInputError: It changes, or the two have no view in common.
    """
    T_map_body = dict(zip(body.views, body.poses, strict=True))
    pairs = zip(camera.views, camera.poses, strict=True)
    found = [invert(T_map_body[view]) @ pose for view, pose in pairs if view in T_map_body]
    if not found or np.ptp(found, axis=0).max() > RIGID_M:
        expected = f"a camera that is rigidly mounted beside {body.sensor}"
        raise InvalidInputError(f"{camera.name}: T_map_camera", "other poses", expected)
    return np.eye(4) if camera is body else found[0]


def _write_truth(
    folder: Path, cameras: Sequence[CameraSequence], mounts: Sequence[FloatArray]
) -> None:
    """Write the body's pose at each view that any camera rendered."""
    rows: dict[int, str] = {}
    for camera, mount in zip(cameras, mounts, strict=True):
        for record, T_map_camera in zip(camera.records, camera.poses, strict=True):
            pose = pose_from_matrix(T_map_camera @ invert(mount))
            x, y, z, w = pose.quat_xyzw
            row = numbers((*pose.position_m, w, x, y, z), ",")
            rows.setdefault(_stamp_ns(record), row)
    head = "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], "
    lines = [f"{stamp_ns},{rows[stamp_ns]}" for stamp_ns in sorted(rows)]
    write_lines(folder, "data.csv", f"{head}q_RS_y [], q_RS_z []", lines)
    sensor = {"sensor_type": "pose", "comment": "simulated truth", "T_BS": _matrix(np.eye(4))}
    _write_yaml(folder, sensor)


def _write_sensors(
    folder: Path, number: int, camera: CameraSequence, T_body_camera: FloatArray
) -> None:
    """Write calibration and list of images for each kind of image that a camera has."""
    for modality, name in FOLDERS.items():
        records = [record for record in camera.records if modality in record.images]
        if not records:
            continue
        sensor = folder / f"{name}{number}"
        lines = [f"{_stamp_ns(r)},{Path(_file(modality, number, r)).name}" for r in records]
        write_lines(sensor, "data.csv", "#timestamp [ns],filename", lines)
        calibration = _calibration(camera, [record.stamp_s for record in records], T_body_camera)
        kind = {"sensor_type": "camera" if modality == RGB else "depth"}
        _write_yaml(sensor, kind | calibration)


def _calibration(
    camera: CameraSequence, stamps_s: Sequence[float], T_body_camera: FloatArray
) -> dict[str, Any]:
    intrinsics = camera.intrinsics()
    k1, k2, p1, p2, k3 = intrinsics.distortion or (0.0,) * 5
    return {
        "comment": camera.sensor,
        "T_BS": _matrix(T_body_camera),
        "rate_hz": rate_hz(stamps_s),
        "resolution": [intrinsics.width_px, intrinsics.height_px],
        "camera_model": "pinhole",
        "intrinsics": [
            intrinsics.fx_px,
            intrinsics.fy_px,
            intrinsics.cx_px,
            intrinsics.cy_px,
        ],
        "distortion_model": "radial-tangential",
        # The format has four; a fifth is written only where it matters.
        "distortion_coefficients": [k1, k2, p1, p2, *([k3] if k3 else [])],
    }


def _matrix(T: FloatArray) -> dict[str, Any]:
    return {"cols": 4, "rows": 4, "data": T.ravel().tolist()}


def _write_yaml(folder: Path, content: Mapping[str, Any]) -> None:
    text = yaml.safe_dump(dict(content), sort_keys=False)
    write_file(folder, "sensor.yaml", text.encode())


def _stamp_ns(record: FrameRecord) -> int:
    return round(record.stamp_s * 1e9)


def _file(modality: str, number: int, record: FrameRecord) -> str:
    suffix = ".exr" if modality == DEPTH else Path(record.images[modality].file).suffix
    return f"{FOLDERS[modality]}{number}/data/{_stamp_ns(record)}{suffix}"
