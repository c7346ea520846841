"""Counts, class shares and histograms of a data set."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import DEPTH, INSTANCE, FloatArray
from oaisys_dataset.formats.base import label_names

if TYPE_CHECKING:
    from oaisys_dataset.reader import Dataset, DatasetSample

MAX_SAMPLED = 400
"""Frames whose pixels are read; of a larger data set, this many at equal distances."""

DEPTH_EDGES_M: FloatArray = np.geomspace(0.1, 10_000.0, 41)
SUN_EDGES_DEG: FloatArray = np.linspace(-90.0, 90.0, 37)


@dataclass(frozen=True)
class Histogram:
    """Shares of values in bins.

    Attributes:
        edges: (N + 1,) bounds of the bins.
        shares: (N,) shares of all values, those outside of the bins included.
    """

    edges: FloatArray
    shares: FloatArray


@dataclass(frozen=True)
class DatasetStatistics:
    """What the data card shows.

    Attributes:
        frames, worlds: Their numbers by split.
        sensors: Number of frames by the sensor's name.
        sizes: Number of frames by image size, such as ``640x480``.
        modalities: Number of frames by modality.
        scans: Number of lidar scans by the lidar's name.
        objects: Number of objects in all worlds by label.
        seconds: Time that the workers took to render the frames and scans.
        workers: Number of workers.
        software: Versions of the programs that rendered the frames.
        class_shares: Share of all pixels by label, the largest first; "" is unlabelled.
        sampled: Number of frames whose pixels the following values are from.
        objects_per_frame: Mean number of objects in view.
        depth_m: Of the pixels that hit something.
        no_hit_share: Share of pixels that hit nothing.
        sun_deg: Elevation of the sun in each frame; None if the frames do not have it.
    """

    frames: Mapping[str, int]
    worlds: Mapping[str, int]
    sensors: Mapping[str, int]
    sizes: Mapping[str, int]
    modalities: Mapping[str, int]
    scans: Mapping[str, int]
    objects: Mapping[str, int]
    seconds: float
    workers: int
    software: Mapping[str, str]
    class_shares: Mapping[str, float]
    sampled: int
    objects_per_frame: float | None
    depth_m: Histogram | None
    no_hit_share: float
    sun_deg: Histogram | None


def statistics_of(
    dataset: Dataset, indices: Sequence[int] | None = None, *, has_scans: bool = True
) -> DatasetStatistics:
    """Return the statistics of a data set, or of what an export holds of it.

    Args:
        dataset: What is counted.
        indices: Of its frames that count; None: all.
        has_scans: Whether its lidar scans count.
    """
    indices = range(len(dataset)) if indices is None else indices
    frames, sensors, sizes, modalities = (Counter[str]() for _ in range(4))
    split_of: dict[int, str] = {}
    seconds, workers, suns = 0.0, set(), []
    software: dict[str, str] = {}
    label_pixels: Counter[int] = Counter()
    for index in indices:
        record = dataset.records[index]
        frames[record.split] += 1
        split_of[record.world] = record.split
        sensors[record.sensor] += 1
        camera = record.intrinsics
        sizes[f"{camera['width_px']}x{camera['height_px']}"] += 1
        modalities.update(record.images.keys())
        seconds += record.seconds
        workers.add(record.worker)
        software.update(record.software)
        label_pixels.update(record.label_pixels)
        if record.sun_elevation_deg is not None:
            suns.append(record.sun_elevation_deg)
    scans: Counter[str] = Counter()
    for scan in dataset.scans if has_scans else ():
        split_of[scan.world] = scan.split
        scans[scan.sensor] += 1
        seconds += scan.seconds
        workers.add(scan.worker)
    names = label_names(dataset)
    objects = Counter(
        names.get(thing.semantic_id, "")
        for world in sorted(split_of)
        for thing in dataset.legend(world).instances.values()
    )
    pixels = _PixelCounts()
    chosen = sample_indices(len(indices), MAX_SAMPLED)
    for place in chosen:
        record = dataset.records[indices[place]]
        pixels.add(dataset.sample(record, [m for m in (DEPTH, INSTANCE) if m in record.images]))
    return DatasetStatistics(
        frames=frames,
        worlds=Counter(split_of.values()),
        sensors=sensors,
        sizes=sizes,
        modalities=modalities,
        scans=scans,
        objects=dict(objects.most_common()),
        seconds=seconds,
        workers=len(workers),
        software=software,
        class_shares=class_shares(label_pixels, names),
        sampled=len(chosen),
        objects_per_frame=pixels.objects_per_frame(),
        depth_m=pixels.depth_histogram(),
        no_hit_share=pixels.no_hit_share(),
        sun_deg=_histogram(np.array(suns), SUN_EDGES_DEG) if suns else None,
    )


def sample_indices(count: int, most: int) -> Sequence[int]:
    """Return at most ``most`` of the first ``count`` whole numbers, at equal distances."""
    places = np.linspace(0, count - 1, min(count, most)).round().astype(int)
    return [int(place) for place in np.unique(places)]


class _PixelCounts:
    """Counts of pixels over the sampled frames."""

    def __init__(self) -> None:
        self._depths = np.zeros(len(DEPTH_EDGES_M) - 1, np.int64)
        self._hits = self._depth_pixels = 0
        self._objects: list[int] = []

    def add(self, sample: DatasetSample) -> None:
        """Count the pixels of a frame."""
        if INSTANCE in sample.arrays:
            ids = np.unique(sample.arrays[INSTANCE])
            self._objects.append(int(np.count_nonzero(ids)))
        if DEPTH in sample.arrays:
            depth_m = sample.arrays[DEPTH]
            hits = depth_m[np.isfinite(depth_m)]
            self._depths += np.histogram(hits, DEPTH_EDGES_M)[0]
            self._hits += hits.size
            self._depth_pixels += depth_m.size

    def objects_per_frame(self) -> float | None:
        """Return the mean number of objects in view."""
        return float(np.mean(self._objects)) if self._objects else None

    def depth_histogram(self) -> Histogram | None:
        """Return the histogram of depth."""
        if not self._hits:
            return None
        return Histogram(DEPTH_EDGES_M, self._depths / self._hits)

    def no_hit_share(self) -> float:
        """Return the share of pixels that hit nothing."""
        return 1 - self._hits / self._depth_pixels if self._depth_pixels else 0.0


def _histogram(values: NDArray[np.float64], edges: FloatArray) -> Histogram:
    return Histogram(edges, np.histogram(values, edges)[0] / max(values.size, 1))


def number_of(count: int, noun: str) -> str:
    """Return a count and its noun, such as ``1 world`` or ``12 worlds``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def class_shares(label_pixels: Counter[int], names: Mapping[int, str]) -> dict[str, float]:
    """Return the share of pixels by label, the largest first; "" is unlabelled."""
    total = label_pixels.total()
    return {
        names.get(label_id, f"label {label_id}" if label_id else ""): pixels / total
        for label_id, pixels in label_pixels.most_common()
    }
