"""KITTI odometry: numbered sequences with poses relative to their first, one for each camera."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import T_LINK_OPTICAL, invert
from oaisys_core.output.records import write_json
from oaisys_core.types import DEPTH, INSTANCE, RGB, FloatArray, PinholeIntrinsics
from oaisys_dataset.formats.base import (
    LEFT_OUT_SCANS,
    WRITTEN_SCANS,
    DatasetFormat,
    ExportOptions,
    FormatConventions,
    write_file,
)
from oaisys_dataset.formats.objects.kitti_labels import LABEL_COLUMNS, frame_lines
from oaisys_dataset.formats.objects.selection import SETTINGS, ObjectSelection
from oaisys_dataset.formats.trajectories.sequences import (
    LOST_DEPTH,
    CameraSequence,
    camera_sequences,
    numbers,
    write_depth_png,
    write_lines,
)

if TYPE_CHECKING:
    from oaisys_dataset.reader import Dataset
    from oaisys_dataset.scans import ScanRecord

UNITS_PER_M = 256.0
"""Of KITTI's depth benchmark."""

RECTIFIED_M = 1e-6
"""Largest entry by which the pose of a right camera may differ from a shift to the right."""

MAX_INTENSITY = 255.0
"""Of our lidars; KITTI's reflectance ends at 1."""

LEFT, RIGHT = 2, 3
"""Numbers of KITTI's colour cameras."""

CONVENTIONS = FormatConventions(
    layout=f"""\
| file | holds |
|---|---|
| `sequences/00/image_2/000000.png` | colour of a camera |
| `sequences/00/image_3/000000.png` | colour of the right camera of a rectified stereo pair |
| `sequences/00/depth_2/000000.png` | depth in 16 bits; of KITTI's depth benchmark |
| `sequences/00/velodyne/000000.bin` | points of the rig's first lidar: x, y, z, reflectance, \
float32 |
| `sequences/00/label_2/000000.txt` | objects in `image_2`, if the data set has their table |
| `sequences/00/calib.txt` | projection matrices `P0` to `P3`, and `Tr` |
| `sequences/00/times.txt` | seconds of simulated time since the world's first view |
| `poses/00.txt` | pose of the left camera, the upper three rows of a matrix |
| `sequences.json` | each sequence's world, camera, split, frames, and first pose in `map` |

There are no grey images: `P0` and `P1` equal `P2` and `P3`. `Tr` takes points from the lidar's \
frame (x forward, y left, z up) to the left camera's; without a lidar, it is that of one at the \
camera's place. Points are as the lidar delivers them, not corrected for its motion during a scan. \
Reflectance is the intensity divided by 255. Scans of further lidars, and of views without an \
image, are left out and counted below.

Frames without colour are left out; where a frame has no depth or no ids, its file in `depth_2` or \
`label_2` is missing. Both are counted below.

{LABEL_COLUMNS}
* The layout of the object benchmark itself is the format `kitti_object`.""",
    reading="""\
```python
from evo.tools import file_interface

trajectory = file_interface.read_kitti_poses_file("poses/00.txt")
```""",
    poses="`poses/00.txt` takes points from the camera's frame to that of the sequence's *first* "
    "frame, as in KITTI. `T_map_first` of `sequences.json` takes them on to `map`: "
    "T_map_camera = T_map_first T_first_camera",
    depth="planar z in units of 1/256 m, or of 1/`depth_per_m` m if that setting was given",
    no_hit="0, which means no measurement; so does depth that does not fit into 16 bits "
    "(256 m with 256 units per metre). Such pixels are counted below",
    labels="not in this format",
)


class KittiFormat(DatasetFormat):
    """Colour, depth, lidar and poses of each camera, as in the KITTI odometry benchmark."""

    name = "kitti"
    writes_scans = True
    modalities = (RGB,)
    images_beside = (DEPTH, INSTANCE)
    settings = MappingProxyType(
        {
            "depth_per_m": "units of depth in a metre; 256, with which depth ends at 256 m",
            **SETTINGS,
        }
    )
    conventions = CONVENTIONS

    def images_needed(self, options: ExportOptions) -> tuple[str, ...]:
        """See `DatasetFormat.images_needed`."""
        return (RGB,)

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        units_per_m = options.number("depth_per_m", UNITS_PER_M, least=1.0)
        counts: Counter[str] = Counter()
        selection = ObjectSelection(dataset, options, counts)
        described: dict[str, Any] = {}
        written: set[str] = set()
        for world, cameras in camera_sequences(dataset.records):
            for left, right in _stereo_pairs([_with_color(camera) for camera in cameras]):
                name = f"{len(described):02d}"
                described[name] = _describe(left, right)
                folder = target / "sequences" / name
                scans = _first_lidar(dataset, world)
                _write_texts(target, name, left, right, scans)
                written |= _write_scans(dataset, folder, left, scans)
                labels = _write_labels(dataset, folder, left, selection)
                if labels:
                    counts["object labels"] += labels
                for number, camera in ((LEFT, left), (RIGHT, right)):
                    for place, record in enumerate(camera.records if camera else ()):
                        files = dataset.files(record)
                        write_file(folder, _file("image", number, place), files[RGB])
                        if DEPTH in files:
                            name = _file("depth", number, place)
                            lost = write_depth_png(folder, name, record, files[DEPTH], units_per_m)
                            counts[LOST_DEPTH] += lost
                        counts["frames"] += 1
                        options.progress(counts["frames"])
        write_json(target / "sequences.json", described)
        if len(dataset.scans):
            counts[WRITTEN_SCANS] = len(written)
            left_out = len(dataset.scans) - len(written)
            if left_out:
                counts[LEFT_OUT_SCANS] = left_out
        return {"sequences": len(described), **counts}


def _first_lidar(dataset: Dataset, world: int) -> dict[int, ScanRecord]:
    """Return the scans of the rig's first lidar in a world by view."""
    if not dataset.scans.has_world(world):
        return {}
    scans = list(dataset.scans.of_world(world))
    return {scan.view: scan for scan in scans if scan.sensor == scans[0].sensor}


def _write_scans(
    dataset: Dataset, folder: Path, left: CameraSequence, scans: Mapping[int, ScanRecord]
) -> set[str]:
    """Write the scans of a sequence's views, and return their ids."""
    written = set()
    for place, record in enumerate(left.records):
        scan = scans.get(record.view)
        if scan is not None:
            points = dataset.scan(scan).data
            write_file(folder, f"velodyne/{place:06d}.bin", velodyne_bytes(points))
            written.add(scan.scan_id)
    return written


def _write_labels(
    dataset: Dataset, folder: Path, left: CameraSequence, selection: ObjectSelection
) -> int:
    """Write the objects of a sequence's images, and return their number."""
    if not dataset.has_objects(left.world):
        return 0
    labels = 0
    for place, record in enumerate(left.records):
        if INSTANCE in record.images:
            lines = frame_lines(dataset, record, selection, np.eye(3))
            write_lines(folder, f"label_2/{place:06d}.txt", "", lines)
            labels += len(lines)
    return labels


def velodyne_bytes(points: NDArray[Any]) -> bytes:
    """Return the file of (N,) points of a lidar: x, y, z, reflectance, float32."""
    columns = [*(points[axis] for axis in "xyz"), points["intensity"] / MAX_INTENSITY]
    return np.column_stack(columns).astype("<f4").tobytes()


def _with_color(camera: CameraSequence) -> CameraSequence:
    """Return the frames that have colour, because images, times and poses have the same numbers.

    Raises:
        InvalidInputError: There are none, or the camera's images are distorted.
    """
    records = tuple(record for record in camera.records if RGB in record.images)
    if not records:
        raise InvalidInputError(camera.name, "no image", "colour, which every sequence needs")
    if any(camera.intrinsics().distortion):
        expected = "a camera without distortion: KITTI's images are rectified"
        raise InvalidInputError(f"{camera.name}: distortion", camera.intrinsics(), expected)
    return replace(camera, records=records)


def _stereo_pairs(
    cameras: Sequence[CameraSequence],
) -> Iterator[tuple[CameraSequence, CameraSequence | None]]:
    """Yield each camera with the right one of its pair, if there is one."""
    rights: dict[str, CameraSequence] = {}
    paired: set[str] = set()
    for left, right in itertools.permutations(cameras, 2):
        if not paired & {left.sensor, right.sensor} and _baseline_m(left, right) > 0:
            rights[left.sensor] = right
            paired |= {left.sensor, right.sensor}
    for camera in cameras:
        if camera.sensor in rights or camera.sensor not in paired:
            yield camera, rights.get(camera.sensor)


def _baseline_m(left: CameraSequence, right: CameraSequence) -> float:
    """Return by how much a camera is shifted to the right of another; 0 if they are no pair."""
    if left.views != right.views or left.intrinsics() != right.intrinsics():
        return 0.0
    offset = np.linalg.inv(left.poses) @ right.poses - np.eye(4)
    baseline_m = float(offset[0, 0, 3])
    offset[:, 0, 3] -= baseline_m
    return baseline_m if np.abs(offset).max() < RECTIFIED_M else 0.0


def _describe(left: CameraSequence, right: CameraSequence | None) -> dict[str, Any]:
    return {
        "world": left.world,
        "split": left.split,
        "sensor": left.sensor,
        "right_sensor": None if right is None else right.sensor,
        "T_map_first": left.poses[0].tolist(),
        "frame_ids": [record.frame_id for record in left.records],
    }


def _write_texts(
    target: Path,
    name: str,
    left: CameraSequence,
    right: CameraSequence | None,
    scans: Mapping[int, ScanRecord],
) -> None:
    folder = target / "sequences" / name
    baseline_m = 0.0 if right is None else _baseline_m(left, right)
    T_left_lidar = _lidar_mount(left, scans)
    lines = _calibration(left.intrinsics(), baseline_m, T_left_lidar)
    write_lines(folder, "calib.txt", "", lines)
    write_lines(folder, "times.txt", "", [f"{stamp_s:.9e}" for stamp_s in left.stamps_s])
    T_first_camera = invert(left.poses[0]) @ left.poses
    lines = [numbers(T[:3].ravel()) for T in T_first_camera]
    write_lines(target, f"poses/{name}.txt", "", lines)


def _lidar_mount(left: CameraSequence, scans: Mapping[int, ScanRecord]) -> FloatArray:
    """Return the pose of the lidar in the left camera's frame."""
    for record in left.records:
        if record.view in scans:
            return np.asarray(invert(record.pose) @ scans[record.view].pose)
    return invert(T_LINK_OPTICAL)


def _calibration(
    intrinsics: PinholeIntrinsics, baseline_m: float, T_left_lidar: FloatArray
) -> list[str]:
    """Return the projection matrices by camera, and the pose of the lidar's frame in the left's."""
    left, right = np.zeros((3, 4)), np.zeros((3, 4))
    left[:, :3] = right[:, :3] = intrinsics.K
    right[0, 3] = -intrinsics.fx_px * baseline_m
    matrices = {"P0": left, "P1": right, "P2": left, "P3": right, "Tr": T_left_lidar[:3]}
    return [f"{name}: {numbers(matrix.ravel())}" for name, matrix in matrices.items()]


def _file(kind: str, number: int, place: int) -> str:
    return f"{kind}_{number}/{place:06d}.png"
