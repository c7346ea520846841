"""The folders that ``oaisys render`` writes: a batch for each world, a sample for each view."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from oaisys_core.config import config_from_mapping
from oaisys_core.dataset.formats.base import (
    DatasetFormat,
    ExportOptions,
    FormatConventions,
    views,
)
from oaisys_core.output.records import pose_from_record, provenance_from_record
from oaisys_core.output.writer import SampleWriter
from oaisys_core.types import Frame, Sample

if TYPE_CHECKING:
    from oaisys_core.dataset.reader import Dataset, DatasetSample

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
| `batch_0013/meta_data/sensor_data/CAMERA.csv` | the camera's pose at each sample |
| `batch_0013/meta_data/sample_data/0001.json` | provenance, cameras and poses of a sample |

`frames.csv` says which world belongs to which split.""",
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
    conventions = CONVENTIONS

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        writer = SampleWriter(target)
        writer.begin(config_from_mapping(dataset.info.config))
        counts: Counter[str] = Counter()
        for view in views(dataset):
            world = view[0].record.world
            writer.write(_sample(view), dataset.legend(world).labels)
            counts["samples"] += 1
            counts["frames"] += len(view)
            options.progress(counts["frames"])
        return counts


def _sample(view: Sequence[DatasetSample]) -> Sample:
    """Return the sample of one view of a world."""
    record = view[0].record
    frames = [
        Frame(
            each.record.sensor,
            modality,
            image,
            each.record.camera,
            each.T_map_camera,
        )
        for each in view
        for modality, image in each.arrays.items()
    ]
    return Sample(
        batch_id=record.world + 1,
        sample_id=record.view + 1,
        rig_pose=pose_from_record(record.rig_pose),
        frames=tuple(frames),
        render_time_s=sum(each.record.seconds for each in view),
        provenance=provenance_from_record(record.provenance),
    )
