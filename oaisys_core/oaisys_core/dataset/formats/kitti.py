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

from oaisys_core.dataset.formats.base import DatasetFormat, ExportOptions, FormatConventions
from oaisys_core.dataset.formats.sequences import (
    LOST_DEPTH,
    CameraSequence,
    camera_sequences,
    depth_png,
    numbers,
    write_file,
    write_lines,
)
from oaisys_core.dataset.shards import read_pixels
from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import T_LINK_OPTICAL, invert
from oaisys_core.output.records import write_json
from oaisys_core.types import DEPTH, RGB, PinholeIntrinsics

if TYPE_CHECKING:
    from oaisys_core.dataset.reader import Dataset

UNITS_PER_M = 256.0
"""Of KITTI's depth benchmark."""

RECTIFIED_M = 1e-6
"""Largest entry by which the pose of a right camera may differ from a shift to the right."""

LEFT, RIGHT = 2, 3
"""Numbers of KITTI's colour cameras."""

CONVENTIONS = FormatConventions(
    layout="""\
| file | holds |
|---|---|
| `sequences/00/image_2/000000.png` | colour of a camera |
| `sequences/00/image_3/000000.png` | colour of the right camera of a rectified stereo pair |
| `sequences/00/depth_2/000000.png` | depth in 16 bits; of KITTI's depth benchmark |
| `sequences/00/calib.txt` | projection matrices `P0` to `P3`, and `Tr` |
| `sequences/00/times.txt` | seconds of simulated time since the world's first view |
| `poses/00.txt` | pose of the left camera, the upper three rows of a matrix |
| `sequences.json` | each sequence's world, camera, split, frames, and first pose in `map` |

There are no grey images: `P0` and `P1` equal `P2` and `P3`. There is no lidar: `Tr` belongs to \
one at the camera's place with axes x forward, y left, z up.""",
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
    """Colour, depth and poses of each camera, as in the KITTI odometry benchmark."""

    name = "kitti"
    modalities = (RGB,)
    settings = MappingProxyType(
        {"depth_per_m": "units of depth in a metre; 256, with which depth ends at 256 m"}
    )
    conventions = CONVENTIONS

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        units_per_m = options.number("depth_per_m", UNITS_PER_M, least=1.0)
        counts: Counter[str] = Counter()
        described: dict[str, Any] = {}
        for _, cameras in camera_sequences(dataset.records):
            for left, right in _stereo_pairs([_with_color(camera) for camera in cameras]):
                name = f"{len(described):02d}"
                described[name] = _described(left, right)
                _write_texts(target, name, left, right)
                folder = target / "sequences" / name
                for number, camera in ((LEFT, left), (RIGHT, right)):
                    for place, record in enumerate(camera.records if camera else ()):
                        files = dataset.files(record)
                        write_file(folder / _file("image", number, place), files[RGB])
                        if DEPTH in files:
                            depth_m = read_pixels(files[DEPTH], DEPTH, record.images[DEPTH].file)
                            png, lost = depth_png(depth_m, units_per_m)
                            write_file(folder / _file("depth", number, place), png)
                            counts[LOST_DEPTH] += lost
                        counts["frames"] += 1
                        options.progress(counts["frames"])
        write_json(target / "sequences.json", described)
        return {"sequences": len(described), **counts}


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


def _described(left: CameraSequence, right: CameraSequence | None) -> dict[str, Any]:
    return {
        "world": left.world,
        "split": left.split,
        "sensor": left.sensor,
        "right_sensor": None if right is None else right.sensor,
        "T_map_first": left.poses[0].tolist(),
        "frame_ids": [record.frame_id for record in left.records],
    }


def _write_texts(
    target: Path, name: str, left: CameraSequence, right: CameraSequence | None
) -> None:
    folder = target / "sequences" / name
    baseline_m = 0.0 if right is None else _baseline_m(left, right)
    write_lines(folder / "calib.txt", "", _calibration(left.intrinsics(), baseline_m))
    write_lines(folder / "times.txt", "", [f"{stamp_s:.9e}" for stamp_s in left.stamps_s])
    T_first_camera = invert(left.poses[0]) @ left.poses
    lines = [numbers(T[:3].ravel()) for T in T_first_camera]
    write_lines(target / "poses" / f"{name}.txt", "", lines)


def _calibration(intrinsics: PinholeIntrinsics, baseline_m: float) -> list[str]:
    """Return the projection matrices by camera, and the pose of the lidar's frame in the left's."""
    left, right = np.zeros((3, 4)), np.zeros((3, 4))
    left[:, :3] = right[:, :3] = intrinsics.K
    right[0, 3] = -intrinsics.fx_px * baseline_m
    matrices = {"P0": left, "P1": right, "P2": left, "P3": right, "Tr": invert(T_LINK_OPTICAL)[:3]}
    return [f"{name}: {numbers(matrix.ravel())}" for name, matrix in matrices.items()]


def _file(kind: str, number: int, place: int) -> str:
    return f"{kind}_{number}/{place:06d}.png"
