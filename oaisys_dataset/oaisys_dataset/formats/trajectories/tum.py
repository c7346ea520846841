"""TUM RGB-D: a folder for each camera in each world, its images named after their times."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from oaisys_core.files.names import path_inside
from oaisys_core.geometry import pose_from_matrix
from oaisys_core.types import DEPTH, RGB
from oaisys_dataset.formats.base import (
    DatasetFormat,
    ExportOptions,
    FormatConventions,
    write_file,
)
from oaisys_dataset.formats.trajectories.sequences import (
    LOST_DEPTH,
    CameraSequence,
    camera_sequences,
    numbers,
    write_depth_png,
    write_lines,
)

if TYPE_CHECKING:
    from oaisys_dataset.manifest import FrameRecord
    from oaisys_dataset.reader import Dataset

UNITS_PER_M = 5000.0
"""The TUM benchmark's own factor, which many programs expect without asking."""

CONVENTIONS = FormatConventions(
    layout="""\
`world_000012_camera/` holds the frames of one camera in one world.

| file | holds |
|---|---|
| `rgb/STAMP.png`, `rgb.txt` | colour, and the stamp and file of each image |
| `depth/STAMP.png`, `depth.txt` | depth in 16 bits, and the stamp and file of each image |
| `associated.txt` | colour and depth images of the same stamp, as `associate.py` pairs them |
| `groundtruth.txt` | `stamp tx ty tz qx qy qz qw` of the camera in `map`, for every view |
| `calibration.txt` | `fx fy cx cy`, and `k1 k2 p1 p2 k3` where the lens distorts |

Stamps are seconds of simulated time since the world's first view.""",
    reading="""\
```python
from evo.tools import file_interface

trajectory = file_interface.read_tum_trajectory_file("world_000000_camera/groundtruth.txt")
```""",
    poses="`groundtruth.txt` takes points from the camera's frame to `map`; quaternions "
    "are x, y, z, w",
    depth="planar z in units of 1/5000 m, or of 1/`depth_per_m` m if that setting was given",
    no_hit="0, which means no measurement; so does depth that does not fit into 16 bits "
    "(13.1 m with 5000 units per metre). Such pixels are counted below",
    labels="not in this format",
)


class TumFormat(DatasetFormat):
    """Colour, depth and trajectory of each camera, as in the TUM RGB-D benchmark."""

    name = "tum"
    modalities = (RGB, DEPTH)
    images_beside = (RGB, DEPTH)
    settings = MappingProxyType(
        {"depth_per_m": "units of depth in a metre; 5000, with which depth ends at 13.1 m"}
    )
    conventions = CONVENTIONS

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        units_per_m = options.number("depth_per_m", UNITS_PER_M, least=1.0)
        counts: Counter[str] = Counter()
        for _, cameras in camera_sequences(dataset.records):
            for sequence in cameras:
                folder = path_inside(target, sequence.name)
                _write_texts(folder, sequence)
                for record in sequence.records:
                    files = dataset.files(record)
                    if RGB in files:
                        write_file(folder, _file(RGB, record), files[RGB])
                    if DEPTH in files:
                        name = _file(DEPTH, record)
                        lost = write_depth_png(folder, name, record, files[DEPTH], units_per_m)
                        counts[LOST_DEPTH] += lost
                    counts["frames"] += 1
                    options.progress(counts["frames"])
                counts["sequences"] += 1
        return counts


def _write_texts(folder: Path, sequence: CameraSequence) -> None:
    with_image = {
        modality: [record for record in sequence.records if modality in record.images]
        for modality in (RGB, DEPTH)
    }
    for modality, records in with_image.items():
        lines = [f"{_stamp(record)} {_file(modality, record)}" for record in records]
        write_lines(folder, f"{modality}.txt", "# timestamp filename", lines)
    both = [record for record in with_image[RGB] if DEPTH in record.images]
    pairs = [" ".join(f"{_stamp(r)} {_file(m, r)}" for m in (RGB, DEPTH)) for r in both]
    write_lines(folder, "associated.txt", "# timestamp rgb timestamp depth", pairs)
    poses = [
        f"{_stamp(record)} {numbers(pose.position_m)} {numbers(pose.quat_xyzw)}"
        for record in sequence.records
        for pose in [pose_from_matrix(record.pose)]
    ]
    write_lines(folder, "groundtruth.txt", "# timestamp tx ty tz qx qy qz qw", poses)
    camera = sequence.intrinsics()
    line = numbers((camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion))
    write_lines(folder, "calibration.txt", "# fx fy cx cy [k1 k2 p1 p2 k3]", [line])


def _stamp(record: FrameRecord) -> str:
    return f"{record.stamp_s:.6f}"


def _file(modality: str, record: FrameRecord) -> str:
    return f"{modality}/{_stamp(record)}.png"
