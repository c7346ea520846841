"""The folders that ``oaisys render`` writes: a batch for each world, a sample for each view."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from oaisys_core.config import config_from_mapping
from oaisys_core.output.records import pose_from_record, provenance_from_record
from oaisys_core.output.writer import SampleWriter
from oaisys_core.types import DEPTH, RGB, Frame, Sample
from oaisys_dataset.formats.base import (
    WRITTEN_SCANS,
    DatasetFormat,
    ExportOptions,
    FormatConventions,
)

if TYPE_CHECKING:
    from oaisys_dataset.manifest import DatasetPart, FrameRecord
    from oaisys_dataset.reader import Dataset
    from oaisys_dataset.scans import ScanRecord

CONVENTIONS = FormatConventions(
    layout="""\
The layout of `oaisys render`. World 12 is `batch_0013`, its view 0 is sample 1.

| file | holds |
|---|---|
| `config.yaml` | the configuration and its hash |
| `batch_0013/labels.json` | label names by id |
| `batch_0013/poses.csv` | the rig's pose at each sample |
| `batch_0013/CAMERA/0001CAMERA_rgb_00.png` | images: PNG (8 and 16 bits), EXR (32-bit floats) |
| `batch_0013/CAMERA/intrinsics.json` | the camera |
| `batch_0013/LIDAR/0001LIDAR_points_00.pcd` | the points of a lidar scan, in the lidar's frame |
| `batch_0013/meta_data/sensor_data/CAMERA.csv` | the camera's pose at each sample |
| `batch_0013/meta_data/sample_data/0001.json` | provenance, cameras and poses of a sample |

`frames.csv` says which world belongs to which split. Of a merged set, each part has a folder of its
own with its configuration, named after its first world, such as `from_world_000012`.""",
    reading="""\
```python
from pathlib import Path

from oaisys_core.output.reader import read_samples

for sample in read_samples(Path("batch_0001")):
    depth_m = sample.frame("camera", "depth").data
```

`oaisys audit` and `oaisys repeat` take this folder.""",
)


class FilesFormat(DatasetFormat):
    """The layout of ``oaisys render``."""

    name = "files"
    writes_scans = True
    images_beside = (RGB, DEPTH)
    conventions = CONVENTIONS
    has_fisheye = True

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        counts: Counter[str] = Counter()
        writers: dict[int, SampleWriter] = {}
        for world in dataset.worlds:
            part = dataset.info.part_of(world)
            if part.first_world not in writers:
                writers[part.first_world] = _writer(target, part, bool(dataset.info.merged))
            writer = writers[part.first_world]
            labels = dataset.legend(world).labels
            for frames, scans in _views(dataset, world):
                writer.write(_sample(dataset, frames, scans), labels)
                counts["samples"] += 1
                counts["frames"] += len(frames)
                if scans:
                    counts[WRITTEN_SCANS] += len(scans)
                options.progress(counts["frames"])
        return counts


def _writer(target: Path, part: DatasetPart, is_merged: bool) -> SampleWriter:
    """Return the writer of a part of a data set: each has a folder with its configuration."""
    folder = target / f"from_world_{part.first_world:06d}" if is_merged else target
    writer = SampleWriter(folder)
    writer.begin(config_from_mapping(part.info.config))
    return writer


def _views(
    dataset: Dataset, world: int
) -> Iterator[tuple[Sequence[FrameRecord], Sequence[ScanRecord]]]:
    """Yield the frames and the lidar scans of each view of a world."""
    frames: dict[int, list[FrameRecord]] = {}
    scans: dict[int, list[ScanRecord]] = {}
    for record in dataset.of_world(world):
        frames.setdefault(record.view, []).append(record)
    for scan in dataset.scans.of_world(world) if dataset.scans.has_world(world) else ():
        scans.setdefault(scan.view, []).append(scan)
    for view in sorted(frames.keys() | scans.keys()):
        yield frames.get(view, []), scans.get(view, [])


def _sample(dataset: Dataset, frames: Sequence[FrameRecord], scans: Sequence[ScanRecord]) -> Sample:
    """Return the sample of one view of a world."""
    records: list[FrameRecord | ScanRecord] = [*frames, *scans]
    first = records[0]
    samples = [dataset.sample(record) for record in frames]
    images = [
        Frame(each.record.sensor, modality, image, each.record.camera, each.T_map_camera)
        for each in samples
        for modality, image in each.arrays.items()
    ]
    return Sample(
        batch_id=first.world + 1,
        sample_id=first.view + 1,
        rig_pose=pose_from_record(first.rig_pose),
        frames=tuple(images),
        render_time_s=sum(record.seconds for record in records),
        provenance=provenance_from_record(first.provenance),
        scans=tuple(dataset.scan(record) for record in scans),
    )
