"""YOLO: images and labels in twin folders, and data.yaml, as ultralytics reads them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from numpy.typing import NDArray

from oaisys_core.output.images import encode_image
from oaisys_core.types import INSTANCE, RGB
from oaisys_dataset.formats.base import (
    DatasetFormat,
    ExportOptions,
    FormatConventions,
    complete_samples,
    label_names,
    thing_ids,
    write_file,
)
from oaisys_dataset.formats.objects.outlines import join_rings, mask_outlines
from oaisys_dataset.formats.objects.selection import SETTINGS, ObjectSelection
from oaisys_dataset.formats.segments import PixelSegment, number_segments, segments_of

if TYPE_CHECKING:
    from oaisys_dataset.reader import Dataset, DatasetSample

BOXES, SEGMENTS = "boxes", "segments"

CONVENTIONS = FormatConventions(
    layout="""\
| file | holds |
|---|---|
| `data.yaml` | the folder of each split, and the name of each class by its number |
| `images/SPLIT/FRAME.png` | colour |
| `labels/SPLIT/FRAME.txt` | a line for each object; empty if none shows |

* A line is `class x y width height`: the centre and size of the box of the pixels that show the
  object. With `--set labels=segments` it is `class x1 y1 x2 y2 ...`, the outline of these pixels.
  All are shares of the image's width and height, from its *corner*.
* Classes are the labels that objects have in any world, in the order of their label ids, from 0.
  An object's class is its own label.
* An outline follows the edges of pixels. Parts that others divide, and holes, are joined by lines
  there and back, because a line has one polygon: filled by the even-odd rule it is exact.
* `data.yaml` has no `path`, so that the folder can be moved: ultralytics then takes that of the
  file. It needs `train` and `val`: if the set has no such split, the key names another one, and a
  comment says so.""",
    reading="""\
```bash
yolo train data=data.yaml model=yolo11n.pt            # --set labels=segments: yolo11n-seg.pt
```""",
    labels="numbers from 0, see `data.yaml`",
    depth="not in this format",
    no_hit="not in this format",
    poses="not in this format; see `frames.csv`",
)


class YoloFormat(DatasetFormat):
    """Colour with boxes or outlines of objects, as ultralytics trains on them."""

    name = "yolo"
    modalities = (RGB, INSTANCE)
    settings = MappingProxyType(
        {"labels": f"{BOXES}, or {SEGMENTS} for the outlines of objects; {BOXES}", **SETTINGS}
    )
    conventions = CONVENTIONS
    has_fisheye = True

    def images_needed(self, options: ExportOptions) -> tuple[str, ...]:
        """See `DatasetFormat.images_needed`."""
        return self.modalities

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        counts: Counter[str] = Counter()
        selection = ObjectSelection(dataset, options, counts)
        with_outlines = options.choice("labels", (BOXES, SEGMENTS)) == SEGMENTS
        names = label_names(dataset)
        classes = {label: number for number, label in enumerate(sorted(thing_ids(dataset)))}
        for sample in complete_samples(dataset, self.modalities, counts):
            record = sample.record
            name = f"{record.split}/{record.frame_id}"
            write_file(target, f"images/{name}.png", encode_image(sample.arrays[RGB]))
            lines = _lines(dataset, sample, classes, selection, counts, with_outlines)
            write_file(target, f"labels/{name}.txt", "".join(lines).encode())
            counts["frames"] += 1
            options.progress(counts["frames"])
        of_class = {number: names[label] for label, number in classes.items()}
        write_file(target, "data.yaml", _data_yaml(dataset.splits, of_class).encode())
        return counts


def _lines(
    dataset: Dataset,
    sample: DatasetSample,
    classes: Mapping[int, int],
    selection: ObjectSelection,
    counts: Counter[str],
    with_outlines: bool,
) -> list[str]:
    """Return the line of each object of a frame."""
    ids = sample.arrays[INSTANCE]
    numbered = number_segments(np.zeros_like(ids), ids)
    segments = list(segments_of(*numbered))
    chosen = selection.choose(sample.record, {s.instance_id: s.area_px for s in segments})
    legend = dataset.legend(sample.record.world).instances
    lines = []
    for segment in segments:
        thing = legend.get(segment.instance_id)
        number = None if thing is None else classes.get(thing.semantic_id)
        if segment.instance_id not in chosen:
            continue
        if number is None:
            counts["objects without a label, left out"] += 1
            continue
        mask = numbered[0] == segment.number
        shares = _outline(mask) if with_outlines else _box(segment, mask.shape)
        lines.append(f"{number} {' '.join(f'{value:.8g}' for value in shares)}\n")
        counts["objects"] += 1
    return lines


def _box(segment: PixelSegment, shape: tuple[int, ...]) -> list[float]:
    left, top, width, height = segment.bbox_px
    rows, columns = shape
    x, y = left + width / 2, top + height / 2
    return [x / columns, y / rows, width / columns, height / rows]


def _outline(mask: NDArray[np.bool_]) -> list[float]:
    rows, columns = mask.shape
    ring = join_rings(mask_outlines(mask))
    shares: list[float] = (ring / (columns, rows)).ravel().tolist()
    return shares


def _data_yaml(splits: tuple[str, ...], names: Mapping[int, str]) -> str:
    """Return data.yaml; ultralytics wants ``train`` and ``val``."""
    folders, notes = {split: f"images/{split}" for split in splits}, ""
    for wanted in ("train", "val"):
        if wanted not in folders:
            folders[wanted] = f"images/{splits[0]}"
            notes += f"# The set has no split {wanted}: it names {splits[0]}.\n"
    data: dict[str, Any] = {**folders, "names": {**names}}
    return notes + yaml.safe_dump(data, sort_keys=False)
