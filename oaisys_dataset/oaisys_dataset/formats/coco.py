"""COCO: instances with masks or polygons, and panoptic images with their segments."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from oaisys_core.files.names import path_inside
from oaisys_core.output.images import encode_image
from oaisys_core.types import INSTANCE, RGB, SEMANTIC_0
from oaisys_dataset.formats.base import (
    DatasetFormat,
    ExportOptions,
    FormatConventions,
    complete_samples,
    label_names,
    thing_ids,
    write_file,
)
from oaisys_dataset.formats.objects.outlines import mask_outlines
from oaisys_dataset.formats.objects.selection import SETTINGS, ObjectSelection
from oaisys_dataset.formats.segments import PixelSegment, number_segments, segments_of

if TYPE_CHECKING:
    from oaisys_dataset.reader import Dataset, DatasetSample

ANNOTATIONS, PANOPTIC = Path("annotations"), Path("panoptic")
"""Apart, because ultralytics' converter takes each JSON file beside instances for one of them."""

RLE, POLYGONS = "rle", "polygons"

CONVENTIONS = FormatConventions(
    layout="""\
| file | holds |
|---|---|
| `SPLIT/FRAME.png` | colour |
| `annotations/instances_SPLIT.json` | objects: masks, boxes, areas |
| `panoptic/panoptic_SPLIT.json`, `panoptic/panoptic_SPLIT/FRAME.png` | every pixel: objects and \
ground; a segment's id is R + 256 G + 65536 B |

* A category's id is the label id of `semantic_0`. *Things* are the labels that objects have in any
  world of the set, *stuff* is the rest: the ground, and the sky if it has a label.
* An object's category is the label of most of its pixels. Pixels that have a thing's label but
  belong to no object (ground painted like a rock) are one annotation with `iscrowd` 1; all others
  have `iscrowd` 0.
* Masks are run-length encoded: Detectron2 needs `cfg.INPUT.MASK_FORMAT = "bitmask"` for them;
  torchvision's detection reference and ultralytics read polygons alone. With
  `--set segmentation=polygons`, objects have polygons along the edges of their pixels, one for each
  part, with holes joined to them; crowds stay run-length encoded, as in COCO itself.
* `--set min_area=` (pixels) and `--set min_visible=` (0 to 1, of an object's silhouette) leave
  objects out; their pixels are void in panoptic images. They are counted below.
* Pixels without a label are in no panoptic segment (id 0, *void*). Objects without a label have no
  annotation: they are counted below.
* `bbox` is (left, top, width, height) in pixels from the image's *corner*: the first pixel covers 0
  to 1. Subtract 0.5 for coordinates in which pixel centres are whole numbers.
* Beyond COCO, an image has `world`, `view`, `sensor`, `K` and `T_map_camera`, and an annotation has
  `instance_id`, the object's id in its world.""",
    reading="""\
```python
from pycocotools.coco import COCO

coco = COCO("annotations/instances_train.json")
mask = coco.annToMask(coco.loadAnns(coco.getAnnIds())[0])
```""",
    labels="`category_id` is the label id of `semantic_0`; `instance_id` is the object's id, "
    "unique in its world, 0 for no object",
    depth="not in this format",
    no_hit="not in this format; pixels that hit nothing are void, or the sky's label",
)


class CocoFormat(DatasetFormat):
    """Colour images with COCO's instance and panoptic annotations, split by split."""

    name = "coco"
    modalities = (RGB, SEMANTIC_0, INSTANCE)
    settings = MappingProxyType(
        {"segmentation": f"{RLE}, or {POLYGONS} for objects; {RLE}", **SETTINGS}
    )
    conventions = CONVENTIONS
    has_fisheye = True

    def images_needed(self, options: ExportOptions) -> tuple[str, ...]:
        """See `DatasetFormat.images_needed`."""
        return self.modalities

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        categories = categories_of(dataset)
        counts: Counter[str] = Counter()
        has_polygons = options.choice("segmentation", (RLE, POLYGONS)) == POLYGONS
        masks = _Masks(ObjectSelection(dataset, options, counts), has_polygons)
        for split in dataset.splits:
            with _SplitWriter(target, split, categories, options.license, masks, counts) as writer:
                part = dataset.split(split)
                for sample in complete_samples(part, self.modalities, counts):
                    writer.add(sample)
                    options.progress(counts["frames"])
        return counts


def categories_of(dataset: Dataset) -> list[dict[str, Any]]:
    """Return COCO's categories: the labels of all worlds, which are things or stuff."""
    things = thing_ids(dataset)
    return [
        {
            "id": label_id,
            "name": name,
            "supercategory": "thing" if label_id in things else "stuff",
            "isthing": int(label_id in things),
        }
        for label_id, name in label_names(dataset).items()
        if label_id
    ]


class _Masks(NamedTuple):
    """Which objects have an annotation, and whether their masks are polygons."""

    selection: ObjectSelection
    has_polygons: bool


class _SplitWriter:
    """Writes the images and annotations of one split."""

    def __init__(
        self,
        target: Path,
        split: str,
        categories: list[dict[str, Any]],
        license_name: str,
        masks: _Masks,
        counts: Counter[str],
    ) -> None:
        self._masks = masks
        self._images = path_inside(target, split)
        annotations, panoptic = target / ANNOTATIONS, target / PANOPTIC
        self._panoptic = path_inside(panoptic, f"panoptic_{split}")
        for each in (self._images, annotations, self._panoptic):
            each.mkdir(parents=True, exist_ok=True)
        self._is_thing = {each["id"]: bool(each["isthing"]) for each in categories}
        self._counts = counts
        self._image_id = 0
        self._annotation_id = 0
        head = {
            "info": {"description": f"{split} split, rendered by OAISYS"},
            "licenses": [{"id": 1, "name": license_name, "url": ""}] if license_name else [],
        }
        things = [each for each in categories if each["isthing"]]
        self._instances_json = _JsonLists(
            path_inside(annotations, f"instances_{split}.json"), {**head, "categories": things}
        )
        self._panoptic_json = _JsonLists(
            path_inside(panoptic, f"panoptic_{split}.json"), {**head, "categories": categories}
        )
        self._files = ExitStack()

    def __enter__(self) -> Self:
        self._files.enter_context(self._instances_json)
        self._files.enter_context(self._panoptic_json)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._files.__exit__(kind, error, trace)

    def add(self, sample: DatasetSample) -> None:
        """Write one frame."""
        self._image_id += 1
        record = sample.record
        height, width = sample.arrays[SEMANTIC_0].shape
        image = {
            "id": self._image_id,
            "file_name": f"{record.frame_id}.png",
            "width": width,
            "height": height,
            "world": record.world,
            "view": record.view,
            "sensor": record.sensor,
            "K": sample.K.tolist(),
            "T_map_camera": sample.T_map_camera.tolist(),
        }
        write_file(self._images, image["file_name"], encode_image(sample.arrays[RGB]))
        self._instances_json.append("images", image)
        self._panoptic_json.append("images", image)
        self._add_segments(sample, image["file_name"])
        self._counts["frames"] += 1

    def _add_segments(self, sample: DatasetSample, file_name: str) -> None:
        numbers, labels, instances = number_segments(
            sample.arrays[SEMANTIC_0], sample.arrays[INSTANCE]
        )
        infos = []
        segments = list(segments_of(numbers, labels, instances))
        visible_px = {each.instance_id: each.area_px for each in segments if each.instance_id}
        chosen = {0, *self._masks.selection.choose(sample.record, visible_px)}
        for segment in segments:
            is_thing = self._is_thing.get(segment.label_id)
            if segment.instance_id not in chosen:
                numbers[numbers == segment.number] = 0
                continue
            if is_thing is None:
                self._counts["objects without a label, left out"] += 1
                numbers[numbers == segment.number] = 0
                continue
            is_crowd = is_thing and not segment.instance_id
            infos.append(_segment_info(segment, is_crowd))
            if is_thing:
                self._append_instance(segment, is_crowd, numbers)
        write_file(self._panoptic, file_name, encode_image(panoptic_colors(numbers)))
        annotation = {"image_id": self._image_id, "file_name": file_name, "segments_info": infos}
        self._panoptic_json.append("annotations", annotation)
        self._counts["panoptic segments"] += len(infos)

    def _append_instance(
        self, segment: PixelSegment, is_crowd: bool, numbers: NDArray[np.int64]
    ) -> None:
        self._annotation_id += 1
        if self._masks.has_polygons and not is_crowd:
            outlines = mask_outlines(numbers == segment.number)
            segmentation: Any = [ring.ravel().tolist() for ring in outlines]
        else:
            segmentation = _compress(segment, numbers.shape)
        annotation = {
            "id": self._annotation_id,
            "image_id": self._image_id,
            "category_id": segment.label_id,
            "segmentation": segmentation,
            "area": segment.area_px,
            "bbox": list(segment.bbox_px),
            "iscrowd": int(is_crowd),
            "instance_id": segment.instance_id,
        }
        self._instances_json.append("annotations", annotation)
        self._counts["crowd annotations" if is_crowd else "object annotations"] += 1


def panoptic_colors(numbers: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return the (H, W, 3) colours of a panoptic image: R + 256 G + 65536 B is the segment's id."""
    planes = [numbers & 0xFF, numbers >> 8 & 0xFF, numbers >> 16 & 0xFF]
    return np.asarray(np.stack(planes, axis=-1), np.uint8)


def _segment_info(segment: PixelSegment, is_crowd: bool) -> dict[str, Any]:
    return {
        "id": segment.number,
        "category_id": segment.label_id,
        "area": segment.area_px,
        "bbox": list(segment.bbox_px),
        "iscrowd": int(is_crowd),
        "instance_id": segment.instance_id,
    }


def _compress(segment: PixelSegment, shape: tuple[int, ...]) -> dict[str, Any]:
    """Return COCO's compressed run-length encoding of a segment's mask."""
    from pycocotools import mask

    height, width = shape
    encoded = mask.frPyObjects({"counts": segment.runs, "size": [height, width]}, height, width)
    return {"size": [height, width], "counts": encoded["counts"].decode("ascii")}


class _JsonLists:
    """A JSON file with one object, two of whose values are lists that grow item by item.

    The items wait in files beside it, so that a large data set needs no memory.
    """

    LISTS = ("images", "annotations")

    def __init__(self, path: Path, head: Mapping[str, Any]) -> None:
        self._path = path
        self._head = head
        self._parts = {name: path.with_name(f".{path.name}.{name}") for name in self.LISTS}
        self._open = ExitStack()

    def __enter__(self) -> Self:
        self._files = {
            name: self._open.enter_context(part.open("w", encoding="utf-8"))
            for name, part in self._parts.items()
        }
        return self

    def append(self, name: str, item: Mapping[str, Any]) -> None:
        """Append an item to a list."""
        self._files[name].write(json.dumps(item) + "\n")

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._open.close()
        if kind is None:
            with self._path.open("w", encoding="utf-8") as file:
                file.writelines(self._text())
        for part in self._parts.values():
            part.unlink()

    def _text(self) -> Iterator[str]:
        yield json.dumps(dict(self._head))[:-1]
        for name, part in self._parts.items():
            yield f', "{name}": ['
            with part.open(encoding="utf-8") as file:
                for index, line in enumerate(file):
                    yield ("," if index else "") + "\n" + line.rstrip("\n")
            yield "]"
        yield "}\n"
