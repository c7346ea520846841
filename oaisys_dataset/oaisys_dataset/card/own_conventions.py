"""The conventions of a data set as ``oaisys dataset render`` writes it."""

from __future__ import annotations

from oaisys_dataset.formats.base import FormatConventions

NAME = "shards"

CONVENTIONS = FormatConventions(
    layout="""\
| file | holds |
|---|---|
| `dataset.json` | configuration, seed, worlds, views, splits |
| `shards/world_000012.tar` | images of a world, and its legend (`legend.json`) |
| `shards/world_000012.jsonl` | a line for each frame: camera, pose, hashes, provenance |
| `shards/world_000012.scans.jsonl` | with lidars: a line for each scan |
| `shards/world_000012.objects.parquet` | with object ids: a row for each frame and object in it |
| `failed/world_000013.json` | why a world could not be made |

Images are lossless: PNG with 8 or 16 bits, TIFF with 32-bit floats, compressed with Zstandard, and
for ids above 65535. Points of lidars are PCD files, in the lidar's frame (x forward, y left, z up)
at the time of each ray.""",
    reading="""\
```python
from oaisys_dataset import open_dataset

for sample in open_dataset(".").split("train"):
    depth_m, K, T_map_camera = sample.arrays["depth"], sample.K, sample.T_map_camera
```

`oaisys dataset export . --format NAME` writes it for other programs.""",
)
