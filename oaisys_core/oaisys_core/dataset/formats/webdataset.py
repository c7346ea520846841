"""WebDataset: tar files of bounded size with one group of files for each frame, and an index."""

from __future__ import annotations

import io
import json
import tarfile
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from oaisys_core.dataset.formats.base import (
    DatasetFormat,
    ExportOptions,
    FormatConventions,
    modality_names,
)
from oaisys_core.dataset.shards import appended, padded
from oaisys_core.errors import InvalidInputError
from oaisys_core.output.images import encode_image
from oaisys_core.types import ALBEDO, RGB

if TYPE_CHECKING:
    import pyarrow as pa

    from oaisys_core.dataset.manifest import FrameRecord
    from oaisys_core.dataset.reader import Dataset, DatasetSample

MOST_BYTES = 1_000_000_000
"""Largest size of a tar file."""

BLOCK = tarfile.BLOCKSIZE
END_BYTES = tarfile.RECORDSIZE
"""Most bytes that a tar file has after its last member."""

INDEX = "index.parquet"

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
    settings = MappingProxyType({"shard_bytes": "largest size of a tar file; default 1e9"})
    conventions = CONVENTIONS

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        most = int(options.number("shard_bytes", MOST_BYTES, least=END_BYTES + 2 * BLOCK))
        counts: Counter[str] = Counter()
        with _Index(target / INDEX, modality_names(dataset)) as index:
            for split in dataset.splits:
                part = dataset.split(split)
                with _TarFiles(target, split, most) as tars:
                    for sample in part.stream():
                        name, places = tars.append(sample.record.frame_id, _files(sample))
                        index.append(sample.record, name, places)
                        counts["frames"] += 1
                        options.progress(counts["frames"])
                    counts["tar files"] += tars.count
                text = json.dumps(_legends(part), indent=1)
                (target / f"legend_{split}.json").write_text(text, encoding="utf-8")
        return counts


class _TarFiles:
    """The tar files of a split; a new one begins where a frame would make one too large."""

    def __init__(self, target: Path, split: str, most_bytes: int) -> None:
        self._target = target
        self._split = split
        self._most_bytes = most_bytes
        self._tar: tarfile.TarFile | None = None
        self._open = ExitStack()
        self.count = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._close()

    def append(
        self, key: str, files: Mapping[str, bytes]
    ) -> tuple[str, dict[str, tuple[int, int]]]:
        """Append a frame; return its tar file, and the offset and size of each of its files."""
        size = sum(BLOCK + padded(len(data)) for data in files.values())
        if size + END_BYTES > self._most_bytes:
            expected = f"at least {size + END_BYTES}, which the frame {key} needs"
            raise InvalidInputError("settings.shard_bytes", self._most_bytes, expected)
        tar = self._tar
        if tar is None or tar.offset + size + END_BYTES > self._most_bytes:
            tar = self._begin()
        places = {
            ending: (appended(tar, f"{key}.{ending}", data), len(data))
            for ending, data in files.items()
        }
        return self._name, places

    def _begin(self) -> tarfile.TarFile:
        self._close()
        self._name = f"{self._split}-{self.count:06d}.tar"
        self.count += 1
        tar = tarfile.TarFile(self._target / self._name, "w", format=tarfile.USTAR_FORMAT)
        self._tar = self._open.enter_context(tar)
        return self._tar

    def _close(self) -> None:
        self._open.close()
        self._tar = None


class _Index:
    """The Parquet file with a row for each frame."""

    ROWS = 10_000
    """Rows that are written together."""

    def __init__(self, path: Path, modalities: Sequence[str]) -> None:
        self._path = path
        self._modalities = modalities
        self._rows: list[dict[str, Any]] = []

    def __enter__(self) -> Self:
        from pyarrow.parquet import ParquetWriter

        self._file = ParquetWriter(self._path, _index_schema(self._modalities))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self._flush()
        self._file.close()

    def append(self, record: FrameRecord, tar: str, places: Mapping[str, tuple[int, int]]) -> None:
        """Add the row of a frame."""
        row = {**frame_fields(record), "tar": tar}
        for modality, image in record.images.items():
            offset, size = places[ending_of(modality)]
            row[f"offset_{modality}"], row[f"size_{modality}"] = offset, size
            row[f"pixels_sha256_{modality}"] = image.pixels_sha256
        self._rows.append(row)
        if len(self._rows) == self.ROWS:
            self._flush()

    def _flush(self) -> None:
        import pyarrow as pa

        schema = _index_schema(self._modalities)
        self._file.write_table(pa.Table.from_pylist(self._rows, schema))
        self._rows.clear()


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


def ending_of(modality: str) -> str:
    """Return the ending of a modality's file, which decoders know it by."""
    return f"{modality}.png" if modality in (RGB, ALBEDO) else f"{modality}.npz"


def _files(sample: DatasetSample) -> dict[str, bytes]:
    """Return the files of a frame by their endings."""
    files = {"json": json.dumps(frame_fields(sample.record)).encode()}
    for modality, image in sample.arrays.items():
        ending = ending_of(modality)
        files[ending] = encode_image(image) if ending.endswith(".png") else _npz_bytes(image)
    return files


def _npz_bytes(image: NDArray[Any]) -> bytes:
    data = io.BytesIO()
    np.savez_compressed(data, data=image)
    return data.getvalue()


def _legends(dataset: Dataset) -> list[dict[str, Any]]:
    """Return the legend of each world."""
    return [{"world": world, **asdict(dataset.legend(world))} for world in dataset.worlds]
