"""WebDataset: tar files of bounded size with one group of files for each frame, and an index."""

from __future__ import annotations

import io
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.output.images import encode_image
from oaisys_core.types import COLORS, DEPTH, RGB, LidarScan
from oaisys_dataset.formats.base import (
    WRITTEN_SCANS,
    DatasetFormat,
    ExportOptions,
    FormatConventions,
    modality_names,
    write_file,
)
from oaisys_dataset.formats.tar_files import MIN_BYTES, ParquetRows, TarFiles

if TYPE_CHECKING:
    import pyarrow as pa

    from oaisys_dataset.manifest import FrameRecord
    from oaisys_dataset.reader import Dataset, DatasetSample
    from oaisys_dataset.scans import ScanRecord

MAX_BYTES = 1_000_000_000
"""Largest size of a tar file."""

INDEX = "index.parquet"

SCANS, SCANS_INDEX = "scans", "index_scans.parquet"
"""Scans have tar files of their own, because Hugging Face's reader wants equal groups in a file."""

POINTS_ENDING = "points.npz"

CONVENTIONS = FormatConventions(
    layout="""\
`SPLIT-000000.tar`, `SPLIT-000001.tar` ... have at most 1 GB each. A frame is a group of files with
one key, such as `000012_0003_camera`:

| file | holds |
|---|---|
| `KEY.rgb.png`, `KEY.albedo.png` | 8-bit colour |
| `KEY.depth.npz`, and all other images | the array under the name `data`, compressed |
| `KEY.json` | `K`, `T_map_camera`, world, view, sensor, split, seed, stamp |

`index.parquet` has a row for each frame: the columns of the JSON file, the tar file, and for each
image its place (`offset_MODALITY`, `size_MODALITY` in bytes) and the hash of its pixels. With them
a frame is read without reading the tar file before it. `legend_SPLIT.json` names labels and
objects, world by world.

Lidar scans are in `scans-SPLIT-000000.tar` ..., each a group such as `000012_0003_lidar`:

| file | holds |
|---|---|
| `KEY.points.npz` | `points_m` (N, 3) in the lidar's frame; `intensity`, `ring`, `time` ... (N,) |
| `KEY.json` | `T_map_lidar`, world, view, sensor, split, seed, stamp, count |

`index_scans.parquet` has a row for each scan.

Label and depth images are arrays, not PNG files, because the image decoders of `webdataset`
convert PNG files to 8 bits.""",
    reading="""\
```python
import webdataset

for frame in webdataset.WebDataset("train-000000.tar", shardshuffle=False).decode("rgb8"):
    rgb, depth_m = frame["rgb.png"], frame["depth.npz"]["data"]
    K = frame["json"]["K"]
```

With Hugging Face: \
`datasets.load_dataset("webdataset", data_files={"train": "train-*.tar"}, streaming=True)`.""",
)


class WebDatasetFormat(DatasetFormat):
    """Tar files for streaming, with a Parquet index."""

    name = "webdataset"
    writes_scans = True
    images_beside = (RGB, DEPTH)
    settings = MappingProxyType({"shard_bytes": "largest size of a tar file; default 1e9"})
    conventions = CONVENTIONS

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        most = options.count("shard_bytes", MAX_BYTES, least=MIN_BYTES)
        counts: Counter[str] = Counter()
        with ParquetRows(target / INDEX, _index_schema(modality_names(dataset))) as index:
            for split in dataset.splits:
                part = dataset.split(split)
                with TarFiles(target, split, most) as tars:
                    for sample in part.stream():
                        name, places = tars.append(sample.record.frame_id, _files(sample))
                        index.append(_index_row(sample.record, name, places))
                        counts["frames"] += 1
                        options.progress(counts["frames"])
                    counts["tar files"] += tars.count
                text = json.dumps(_legends(part), indent=1)
                write_file(target, f"legend_{split}.json", text.encode())
        if len(dataset.scans):
            _write_scans(dataset, target, most, counts)
        return counts


def _write_scans(dataset: Dataset, target: Path, most_bytes: int, counts: Counter[str]) -> None:
    with ParquetRows(target / SCANS_INDEX, _scans_schema()) as index:
        for split in dataset.splits:
            part = dataset.split(split)
            if not len(part.scans):
                continue
            with TarFiles(target, f"{SCANS}-{split}", most_bytes) as tars:
                for record in part.scans:
                    row = scan_fields(record)
                    points = _npz_bytes(**scan_arrays(dataset.scan(record)))
                    files = {"json": json.dumps(row).encode(), POINTS_ENDING: points}
                    name, places = tars.append(record.scan_id, files)
                    offset, size = places[POINTS_ENDING]
                    where = {"tar": name, "offset_points": offset, "size_points": size}
                    index.append({**row, **where})
                    counts[WRITTEN_SCANS] += 1
                counts["tar files"] += tars.count


def _index_row(
    record: FrameRecord, tar: str, places: Mapping[str, tuple[int, int]]
) -> dict[str, Any]:
    row = {**frame_fields(record), "tar": tar}
    for modality, image in record.images.items():
        offset, size = places[ending_of(modality)]
        row[f"offset_{modality}"], row[f"size_{modality}"] = offset, size
        row[f"pixels_sha256_{modality}"] = image.pixels_sha256
    return row


def _index_schema(modalities: Sequence[str]) -> pa.Schema:
    import pyarrow as pa

    matrix = pa.list_(pa.list_(pa.float64()))
    fields = {name: pa.string() for name in ("frame_id", "sensor", "split", "tar")}
    fields |= {name: pa.int64() for name in ("world", "view", "world_seed")}
    fields |= {name: pa.int64() for name in ("width_px", "height_px")}
    fields |= {"stamp_s": pa.float64(), "distortion": pa.list_(pa.float64())}
    fields |= {"K": matrix, "T_map_camera": matrix}
    for modality in modalities:
        fields |= {f"{what}_{modality}": pa.int64() for what in ("offset", "size")}
        fields[f"pixels_sha256_{modality}"] = pa.string()
    return pa.schema(fields)


def frame_fields(record: FrameRecord) -> dict[str, Any]:
    """Return the fields of a frame's JSON file, which have the same types in every data set."""
    camera = record.intrinsics
    return {
        "frame_id": record.frame_id,
        "split": record.split,
        "world": record.world,
        "view": record.view,
        "sensor": record.sensor,
        "world_seed": record.world_seed,
        "stamp_s": record.stamp_s,
        "width_px": camera["width_px"],
        "height_px": camera["height_px"],
        "K": camera["K"],
        "distortion": [*camera["distortion"], *[0.0] * 5][:5],
        "T_map_camera": [list(row) for row in record.T_map_camera],
    }


def scan_fields(record: ScanRecord) -> dict[str, Any]:
    """Return the fields of a lidar scan's JSON file."""
    return {
        "scan_id": record.scan_id,
        "split": record.split,
        "world": record.world,
        "view": record.view,
        "sensor": record.sensor,
        "world_seed": record.world_seed,
        "stamp_s": record.stamp_s,
        "count": record.points.count,
        "T_map_lidar": [list(row) for row in record.T_map_lidar],
    }


def scan_arrays(scan: LidarScan) -> dict[str, NDArray[Any]]:
    """Return the points of a scan: ``points_m`` (N, 3), and each other field (N,) by its name."""
    names = [name for name in scan.data.dtype.names or () if name not in ("x", "y", "z")]
    return {"points_m": scan.points_m, **{name: scan.data[name] for name in names}}


def _scans_schema() -> pa.Schema:
    import pyarrow as pa

    fields = {name: pa.string() for name in ("scan_id", "sensor", "split", "tar")}
    fields |= {name: pa.int64() for name in ("world", "view", "world_seed", "count")}
    fields |= {"stamp_s": pa.float64(), "T_map_lidar": pa.list_(pa.list_(pa.float64()))}
    fields |= {f"{what}_points": pa.int64() for what in ("offset", "size")}
    return pa.schema(fields)


def ending_of(modality: str) -> str:
    """Return the ending of a modality's file, which decoders know it by."""
    return f"{modality}.png" if modality in COLORS else f"{modality}.npz"


def _files(sample: DatasetSample) -> dict[str, bytes]:
    """Return the files of a frame by their endings."""
    files = {"json": json.dumps(frame_fields(sample.record)).encode()}
    for modality, image in sample.arrays.items():
        ending = ending_of(modality)
        files[ending] = encode_image(image) if ending.endswith(".png") else _npz_bytes(data=image)
    return files


def _npz_bytes(**arrays: NDArray[Any]) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def _legends(dataset: Dataset) -> list[dict[str, Any]]:
    """Return the legend of each world."""
    return [{"world": world, **asdict(dataset.legend(world))} for world in dataset.worlds]
