"""KITTI's object benchmark: numbered images with labels, calibration and lidar points."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import T_LINK_OPTICAL, invert
from oaisys_core.output.images import encode_image
from oaisys_core.output.records import write_json
from oaisys_core.types import INSTANCE, RGB, FloatArray, LidarScan
from oaisys_dataset.formats.base import (
    LEFT_OUT_SCANS,
    WRITTEN_SCANS,
    DatasetFormat,
    ExportOptions,
    FormatConventions,
    complete_samples,
    write_file,
)
from oaisys_dataset.formats.objects.kitti_labels import (
    LABEL_COLUMNS,
    frame_lines,
    level_rotation,
)
from oaisys_dataset.formats.objects.selection import SETTINGS, ObjectSelection
from oaisys_dataset.formats.trajectories.kitti import velodyne_bytes
from oaisys_dataset.formats.trajectories.sequences import numbers, write_lines

if TYPE_CHECKING:
    from oaisys_dataset.manifest import FrameRecord
    from oaisys_dataset.reader import Dataset, DatasetSample

CAMERA, LEVEL = "camera", "level"

CONVENTIONS = FormatConventions(
    layout=f"""\
| file | holds |
|---|---|
| `training/image_2/000000.png` | colour |
| `training/label_2/000000.txt` | a line for each object that shows |
| `training/calib/000000.txt` | `P0` to `P3`, all of this camera; `R0_rect`, `Tr_velo_to_cam`, \
`Tr_imu_to_velo` |
| `training/velodyne/000000.bin` | points of the view's first lidar: x, y, z, reflectance, float32 |
| `ImageSets/SPLIT.txt` | the numbers of a split's images; all are in `training/`, because all \
have labels |
| `frames.json` | the frame of each number |

{LABEL_COLUMNS}
* With `--set frame=level`, the labels' frame has the camera's origin and heading, but its y axis
  points down along `map`'s: objects that stand upright then have their exact boxes. `P2` and
  `Tr_velo_to_cam` lead from that frame, so they are no longer those of the tilted camera alone.""",
    reading="""\
```python
import numpy as np

lines = open("training/calib/000000.txt").read().split("\\n")
P2 = np.array(lines[2].split()[1:], float).reshape(3, 4)  # pixel = P2 @ (x, y, z, 1)
```""",
    poses="locations are in the camera's frame; the camera's pose in `map` is in `frames.csv`",
    labels="`type` is the object's label",
    depth="not in this format",
    no_hit="not in this format",
)


class KittiObjectFormat(DatasetFormat):
    """Colour, 3D boxes and calibration of each frame, as in the KITTI object benchmark."""

    name = "kitti_object"
    modalities = (RGB, INSTANCE)
    writes_scans = True
    settings = MappingProxyType(
        {"frame": f"frame of the labels, {CAMERA} or {LEVEL}; {CAMERA}", **SETTINGS}
    )
    conventions = CONVENTIONS

    def images_needed(self, options: ExportOptions) -> tuple[str, ...]:
        """See `DatasetFormat.images_needed`."""
        return self.modalities

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        counts: Counter[str] = Counter()
        selection = ObjectSelection(dataset, options, counts)
        is_level = options.choice("frame", (CAMERA, LEVEL)) == LEVEL
        lists: dict[str, list[str]] = {split: [] for split in dataset.splits}
        frames: dict[str, str] = {}
        scans: set[str] = set()
        for sample in complete_samples(dataset, self.modalities, counts):
            check_rectified(sample.record, self.name)
            number = f"{counts['frames']:06d}"
            R = level_rotation(sample.T_map_camera) if is_level else np.eye(3)
            folder = target / "training"
            write_file(folder, f"image_2/{number}.png", encode_image(sample.arrays[RGB]))
            lines = frame_lines(dataset, sample.record, selection, R)
            write_lines(folder, f"label_2/{number}.txt", "", lines)
            scan = next(iter(dataset.scans_beside(sample.record).values()), None)
            write_lines(folder, f"calib/{number}.txt", "", _calibration(sample, scan, R))
            if scan is not None:
                write_file(folder, f"velodyne/{number}.bin", velodyne_bytes(scan.data))
                scans.add(f"{sample.record.world}/{sample.record.view}/{scan.sensor}")
            lists[sample.record.split].append(number)
            frames[number] = sample.record.frame_id
            counts["objects"] += len(lines)
            counts["frames"] += 1
            options.progress(counts["frames"])
        for split, listed in lists.items():
            write_lines(target, f"ImageSets/{split}.txt", "", listed)
        write_json(target / "frames.json", frames)
        if len(dataset.scans):
            counts[WRITTEN_SCANS] = len(scans)
            if len(dataset.scans) > len(scans):
                counts[LEFT_OUT_SCANS] = len(dataset.scans) - len(scans)
        return counts


def check_rectified(record: FrameRecord, name: str) -> None:
    """Raise unless a frame's camera is a pinhole without distortion.

    Raises:
        InvalidInputError: It distorts.
    """
    if not record.camera.is_rectilinear:
        expected = f"a camera without distortion, which {name} cannot describe"
        raise InvalidInputError(f"{record.frame_id}: distortion", record.camera, expected)


def _calibration(sample: DatasetSample, scan: LidarScan | None, R: FloatArray) -> list[str]:
    """Return the matrices of a frame; ``R`` leads from the camera's frame to the labels'."""
    projection = np.zeros((3, 4))
    projection[:, :3] = sample.K @ R.T
    T_label_camera = np.eye(4)
    T_label_camera[:3, :3] = R
    T_camera_lidar = invert(T_LINK_OPTICAL)
    if scan is not None:
        T_camera_lidar = invert(sample.T_map_camera) @ scan.T_map_lidar
    matrices = {
        **{f"P{camera}": projection for camera in range(4)},
        "R0_rect": np.eye(3),
        "Tr_velo_to_cam": (T_label_camera @ T_camera_lidar)[:3],
        "Tr_imu_to_velo": np.eye(4)[:3],
    }
    return [f"{name}: {numbers(matrix.ravel())}" for name, matrix in matrices.items()]
