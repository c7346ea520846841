"""HDF5: one file for each world, with all images, poses and cameras as chunked datasets."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.names import path_inside
from oaisys_core.types import (
    ALBEDO,
    DEPTH,
    DEPTH_TRUE,
    DIGITAL,
    DISPARITY,
    DISTANCES,
    FLOW,
    INSTANCE,
    NORMAL,
    RADIANCE,
    RANGE,
    RANGE_TRUE,
    RGB,
    point_dtype,
    semantic_level,
)
from oaisys_dataset.formats.base import (
    WRITTEN_SCANS,
    DatasetFormat,
    ExportOptions,
    FormatConventions,
)
from oaisys_dataset.formats.file_that_closes import FileThatCloses
from oaisys_dataset.records import world_name

if TYPE_CHECKING:
    import h5py

    from oaisys_dataset.manifest import FrameRecord
    from oaisys_dataset.reader import Dataset, DatasetSample, WorldLegend
    from oaisys_dataset.scans import ScanRecord

COMPRESSION = 4
"""Level of gzip; higher levels take much longer and save a few percent."""

UNITS = {
    RGB: "sRGB, 0 to 255",
    ALBEDO: "sRGB-encoded reflectance, 0 to 255",
    **dict.fromkeys(sorted(DISTANCES), "m"),
    NORMAL: "1",
    FLOW: "px",
    DISPARITY: "px",
    INSTANCE: "id",
    RADIANCE: "W/(m2 sr)",
    **dict.fromkeys(DIGITAL, "DN"),
}
MEANING = {
    DEPTH: "planar z at the pixel's centre; +inf: nothing was hit",
    RANGE: "length of the ray through the pixel's centre; +inf: nothing was hit",
    DEPTH_TRUE: "as depth, without the faults of the sensor",
    RANGE_TRUE: "as range, without the faults of the sensor",
    NORMAL: "unit normal (x, y, z) in the camera's frame, towards the camera; 0: nothing was hit",
    FLOW: "motion (du, dv) since the sensor's previous view; NaN: not known",
    DISPARITY: "distance between the images of a stereo pair; 0: nothing was hit",
    RADIANCE: "in the bands 600 to 700, 500 to 600 and 400 to 500 nm; linear, never clipped",
    INSTANCE: "object id, 0: no object; names in /legend/instances",
}
CAMERA = {
    "T_map_camera": ("m", "takes points from the camera's frame to map"),
    "K": ("px", "camera matrix; the centre of the first pixel is (0, 0)"),
    "distortion": ("1", "Brown-Conrady k1, k2, p1, p2, k3; all 0: none"),
    "stamp_s": ("s", "simulated time in the world"),
    "view": ("1", "index of the view in the world"),
    "frame_id": ("", "name of the frame in the manifest"),
}

LIDAR = {
    "points": ("m", "x, y, z in the lidar's frame at the time of the ray; intensity 0 to 255, s"),
    "first": ("1", "scan k is points[first[k]:first[k + 1]]"),
    "T_map_lidar": ("m", "takes points from the lidar's frame (x forward, z up) to map"),
    "stamp_s": ("s", "simulated time in the world at which the scan begins"),
    "view": ("1", "index of the view in the world"),
    "scan_id": ("", "name of the scan in the manifest"),
}

POINTS_CHUNK = 16384
"""Points that are compressed together."""

CONVENTIONS = FormatConventions(
    layout="""\
`SPLIT/world_000012.h5` is one world. Its N views from each camera are stacked along the first axis.

| dataset | shape | unit |
|---|---|---|
| `/SENSOR/rgb`, `albedo` | (N, H, W, 3) uint8 | sRGB |
| `/SENSOR/depth`, `range`, `disparity` | (N, H, W) float32 | m, m, px |
| `/SENSOR/normal`, `flow` | (N, H, W, 3 or 2) float32 | 1, px |
| `/SENSOR/semantic_0` ..., `instance` | (N, H, W) uint16, uint32 | id |
| `/SENSOR/T_map_camera` | (N, 4, 4) float64 | m |
| `/SENSOR/K` | (N, 3, 3) float64 | px |
| `/SENSOR/distortion` | (N, 5) float64 | 1 (k1, k2, p1, p2, k3) |
| `/SENSOR/stamp_s` | (N,) float64 | s |
| `/SENSOR/view`, `frame_id` | (N,) int64, text | |
| `/LIDAR/points` | (P,) | x, y, z, intensity, ring, time, ... |
| `/LIDAR/first` | (M + 1,) int64 | scan k is `points[first[k]:first[k + 1]]` |
| `/LIDAR/T_map_lidar` | (M, 4, 4) float64 | m |
| `/LIDAR/stamp_s`, `view`, `scan_id` | (M,) float64, int64, text | s |
| `/legend/labels` | (id, name) | |
| `/legend/instances` | (id, name, semantic_id, label) | |

Images are chunked image by image and compressed with gzip and the byte-shuffle filter. Each
dataset has the attribute `unit`, and `meaning` where the name does not say it. Those of images have
`missing`: the rows of views without this image, which are NaN or 0. The file's attributes are
`world`, `world_seed`, `split`, `config_sha256` and `conventions`, which is this page's list as
JSON.""",
    reading="""\
```python
import h5py

with h5py.File("train/world_000000.h5") as world:
    depth_m = world["camera/depth"][0]
    K, T_map_camera = world["camera/K"][0], world["camera/T_map_camera"][0]
```""",
)


class Hdf5Format(DatasetFormat):
    """Every modality of a world in one HDF5 file, with its lidar scans."""

    name = "hdf5"
    writes_scans = True
    settings = MappingProxyType({"compression": "level of gzip, 0 to 9; default 4"})
    conventions = CONVENTIONS

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        level = options.count("compression", COMPRESSION)
        if level > 9:
            raise InvalidInputError("settings.compression", level, "a level from 0 to 9")
        sizes = Counter((record.world, record.sensor) for record in dataset.records)
        counts: Counter[str] = Counter()
        for world, samples in groupby(dataset.stream(), key=lambda sample: sample.record.world):
            of_sensors = {sensor: n for (owner, sensor), n in sizes.items() if owner == world}
            with _WorldFile(target, dataset.legend(world), of_sensors, level) as file:
                for sample in samples:
                    file.add(sample)
                    counts["frames"] += 1
                    options.progress(counts["frames"])
                if dataset.scans.has_world(world):
                    counts[WRITTEN_SCANS] += file.add_scans(dataset, world)
                if file.missing:
                    counts["images that views lack, NaN or 0 in their rows"] += file.missing
            counts["worlds"] += 1
        return counts


class _WorldFile:
    """The file of one world, made at its first sample.

    Attributes:
        missing: Number of images that views lack, of those that their sensor's first view has.
    """

    def __init__(
        self, target: Path, legend: WorldLegend, sizes: Mapping[str, int], level: int
    ) -> None:
        self._target = target
        self._legend = legend
        self._sizes = sizes
        self._level = level
        self._next = dict.fromkeys(sizes, 0)
        self._file: h5py.File | None = None
        self._bytes: FileThatCloses | None = None
        self._images: dict[str, set[str]] = {}
        self.missing = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None and self._bytes is not None:
            self._file.close()
            self._bytes.close()
            self._bytes.raise_fault()

    def add(self, sample: DatasetSample) -> None:
        """Write the next view of a sensor."""
        record = sample.record
        file = self._file = self._file or self._begin(record)
        row, sensor = self._next[record.sensor], record.sensor
        self._next[sensor] += 1
        if not row:
            self._add_sensor(_group(file, sensor), sample)
        for name, value in {**sample.arrays, **_camera_values(sample)}.items():
            place = file[sensor].get(name)
            if place is None or place.shape[1:] != np.shape(value):
                found = "nothing" if place is None else f"{place.shape[1:]} pixels"
                expected = f"the same image in every view of a world; the first has {found}"
                raise InvalidInputError(f"{record.frame_id}.{name}", np.shape(value), expected)
            place[row] = value
        for name in self._images[sensor] - sample.arrays.keys():
            rows = file[sensor][name].attrs
            rows["missing"] = np.append(rows["missing"], row)
            self.missing += 1
        self._raise_fault()

    def _raise_fault(self) -> None:
        if self._bytes is not None:
            self._bytes.raise_fault()

    def add_scans(self, dataset: Dataset, world: int) -> int:
        """Write the scans of all lidars, after the samples, and return their number."""
        if self._file is None:
            raise InvalidInputError("dataset", f"world {world}", "at least one frame in each world")
        by_lidar: dict[str, list[ScanRecord]] = {}
        for record in dataset.scans.of_world(world):
            by_lidar.setdefault(record.sensor, []).append(record)
        for lidar, records in by_lidar.items():
            self._add_lidar(_group(self._file, lidar), dataset, records)
        return sum(map(len, by_lidar.values()))

    def _add_lidar(
        self, group: h5py.Group, dataset: Dataset, records: Sequence[ScanRecord]
    ) -> None:
        import h5py

        first = np.cumsum([0, *(record.points.count for record in records)])
        values = {
            "first": first,
            "T_map_lidar": np.array([record.pose for record in records]),
            "stamp_s": np.array([record.stamp_s for record in records]),
            "view": np.array([record.view for record in records]),
            "scan_id": np.array([record.scan_id for record in records], h5py.string_dtype()),
        }
        for name, value in values.items():
            group[name] = value
            group[name].attrs["unit"], group[name].attrs["meaning"] = LIDAR[name]
        names = records[0].points.fields
        usual = point_dtype().names or ()
        points = group.create_dataset(
            "points",
            (int(first[-1]),),
            point_dtype([name for name in names if name not in usual]),
            chunks=(POINTS_CHUNK,),
            maxshape=(None,),
            compression="gzip",
            compression_opts=self._level,
            shuffle=True,
        )
        points.attrs["unit"], points.attrs["meaning"] = LIDAR["points"]
        for record, begin in zip(records, first.tolist(), strict=False):
            points[begin : begin + record.points.count] = dataset.scan(record).data
            self._raise_fault()

    def _begin(self, record: FrameRecord) -> h5py.File:
        import h5py

        path = path_inside(self._target, record.split, f"{world_name(record.world)}.h5")
        path.parent.mkdir(exist_ok=True)
        self._bytes = FileThatCloses(path)
        file = h5py.File(self._bytes, "w")
        file.attrs["world"], file.attrs["split"] = record.world, record.split
        file.attrs["world_seed"] = np.uint64(record.world_seed)
        file.attrs["config_sha256"] = record.config_sha256
        shared = {k: v for k, v in asdict(CONVENTIONS).items() if k not in ("layout", "reading")}
        file.attrs["conventions"] = json.dumps(shared)
        self._add_legend(file.create_group("legend"))
        return file

    def _add_legend(self, group: h5py.Group) -> None:
        import h5py

        text = h5py.string_dtype()
        labels = self._legend.labels
        rows: list[tuple[object, ...]] = list(labels.items())
        group["labels"] = np.array(rows, [("id", "u2"), ("name", text)])
        rows = [
            (i, thing.name, thing.semantic_id, labels.get(thing.semantic_id, ""))
            for i, thing in self._legend.instances.items()
        ]
        fields = [("id", "u4"), ("name", text), ("semantic_id", "u2"), ("label", text)]
        group["instances"] = np.array(rows, fields)

    def _add_sensor(self, group: h5py.Group, sample: DatasetSample) -> None:
        import h5py

        taken = CAMERA.keys() & sample.arrays.keys()
        if taken:
            expected = "another name than those of the values beside the images"
            raise InvalidInputError("modality", ", ".join(sorted(taken)), expected)
        views = self._sizes[sample.record.sensor]
        self._images[sample.record.sensor] = set(sample.arrays)
        for modality, image in sample.arrays.items():
            data = group.create_dataset(
                modality,
                (views, *image.shape),
                image.dtype,
                chunks=(1, *image.shape),
                compression="gzip",
                compression_opts=self._level,
                shuffle=True,
                fillvalue=np.nan if image.dtype.kind == "f" else 0,
            )
            data.attrs["unit"] = UNITS.get(
                modality, "id" if semantic_level(modality) is not None else ""
            )
            data.attrs["meaning"] = MEANING.get(modality, "")
            data.attrs["missing"] = np.empty(0, np.int64)
        for name, value in _camera_values(sample).items():
            dtype = h5py.string_dtype() if isinstance(value, str) else np.asarray(value).dtype
            data = group.create_dataset(name, (views, *np.shape(value)), dtype)
            data.attrs["unit"], data.attrs["meaning"] = CAMERA[name]


def _group(file: h5py.File, sensor: str) -> h5py.Group:
    """Return a new group for a sensor."""
    if sensor in file:
        raise InvalidInputError("sensor", sensor, f"a name other than {', '.join(file)}")
    return file.create_group(sensor)


def _camera_values(sample: DatasetSample) -> dict[str, Any]:
    """Return what a view has beside its images, by the names of the datasets."""
    record = sample.record
    distortion = np.zeros(5)
    given = record.intrinsics["distortion"]
    distortion[: len(given)] = given
    return {
        "T_map_camera": np.asarray(sample.T_map_camera, np.float64),
        "K": np.asarray(sample.K, np.float64),
        "distortion": distortion,
        "stamp_s": np.float64(record.stamp_s),
        "view": np.int64(record.view),
        "frame_id": record.frame_id,
    }
