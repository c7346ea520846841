"""Semantic masks as images with a palette, in the layout of PASCAL VOC."""

from __future__ import annotations

import io
import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.output.images import encode_image
from oaisys_core.types import RGB
from oaisys_dataset.formats.base import (
    DatasetFormat,
    ExportOptions,
    FormatConventions,
    complete_samples,
    label_names,
    write_file,
)

if TYPE_CHECKING:
    from oaisys_dataset.reader import Dataset

ROOT = "VOCdevkit/VOC2012"
"""Where torchvision's ``VOCSegmentation`` looks."""

UNLABELLED = "unlabelled"
MAX_CLASSES = 255
"""Of an image with a palette; 255 itself is what trainers ignore."""

JPEG_QUALITY = 95

CONVENTIONS = FormatConventions(
    layout=f"""\
| file | holds |
|---|---|
| `{ROOT}/JPEGImages/FRAME.jpg` | colour, as JPEG of quality {JPEG_QUALITY}; \
`--set images=png` keeps it lossless, which torchvision's reader does not look for |
| `{ROOT}/SegmentationClass/FRAME.png` | the class of each pixel: 8 bits with a palette |
| `{ROOT}/ImageSets/Segmentation/SPLIT.txt` | the names of a split's frames |
| `classes.json` | of each class its number, name, colour, and label id in `semantic_N` |

* Class 0 is *unlabelled*, what VOC calls background; the labels follow in the order of their ids,
  from 1 without gaps. No pixel is 255, which trainers ignore.
* Colours are VOC's: bit by bit from the number of the class.
* mmsegmentation: `BaseSegDataset` with `data_root='{ROOT}'`, `img_suffix='.jpg'`,
  `data_prefix=dict(img_path='JPEGImages', seg_map_path='SegmentationClass')`,
  `ann_file='ImageSets/Segmentation/train.txt'`, and `reduce_zero_label=True` to ignore what is
  unlabelled.""",
    reading="""\
```python
from torchvision.datasets import VOCSegmentation

image, mask = VOCSegmentation(".", year="2012", image_set="train")[0]
```""",
    labels="numbers from 1 without gaps, see `classes.json`; 0 is unlabelled",
    color="sRGB, 8 bits; JPEG loses some of it",
    depth="not in this format",
    no_hit="0, unlabelled, or the sky's label",
    poses="not in this format; see `frames.csv`",
)


class MasksFormat(DatasetFormat):
    """Colour and semantic masks with a palette, with lists of splits, as in PASCAL VOC."""

    name = "masks"
    modalities = (RGB,)
    settings = MappingProxyType(
        {
            "level": "N of the labels semantic_N; 0",
            "images": "jpg, or png for lossless colour; jpg",
        }
    )
    conventions = CONVENTIONS
    has_fisheye = True

    def images_needed(self, options: ExportOptions) -> tuple[str, ...]:
        """See `DatasetFormat.images_needed`."""
        return (RGB, _labels_of(options))

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        suffix = options.choice("images", ("jpg", "png"))
        labels = _labels_of(options)
        counts: Counter[str] = Counter()
        classes: dict[int, int] = {0: 0}
        names = {label: name for label, name in label_names(dataset).items() if label}
        if len(names) >= MAX_CLASSES:
            expected = f"at most {MAX_CLASSES - 1} labels, which fit into 8 bits"
            raise InvalidInputError(labels, f"{len(names)} labels", expected)
        classes |= {label: number for number, label in enumerate(names, start=1)}
        lists: dict[str, list[str]] = {split: [] for split in dataset.splits}
        for sample in complete_samples(dataset, (RGB, labels), counts):
            record = sample.record
            file = _encode_color(sample.arrays[RGB], suffix)
            write_file(target, f"{ROOT}/JPEGImages/{record.frame_id}.{suffix}", file)
            mask = _numbers(sample.arrays[labels], classes)
            png = encode_palette_png(mask)
            write_file(target, f"{ROOT}/SegmentationClass/{record.frame_id}.png", png)
            lists[record.split].append(f"{record.frame_id}\n")
            counts["frames"] += 1
            options.progress(counts["frames"])
        for split, lines in lists.items():
            name = f"{ROOT}/ImageSets/Segmentation/{split}.txt"
            write_file(target, name, "".join(lines).encode())
        write_file(target, "classes.json", _classes_json(classes, names).encode())
        return counts


def _labels_of(options: ExportOptions) -> str:
    """Return the image of labels that is exported."""
    return f"semantic_{options.choice('level', tuple('0123456789'))}"


def _numbers(labels: NDArray[Any], classes: Mapping[int, int]) -> NDArray[np.uint8]:
    """Return the (H, W) classes of label ids.

    Raises:
        InvalidInputError: An id is in no legend.
    """
    found, places = np.unique(labels, return_inverse=True)
    unknown = [label for label in found.tolist() if label not in classes]
    if unknown:
        raise InvalidInputError("label ids", unknown, "ids that the legend names")
    numbers = np.array([classes[label] for label in found.tolist()], np.uint8)
    return numbers[places].reshape(labels.shape)


def voc_palette() -> NDArray[np.uint8]:
    """Return the (256, 3) colours of PASCAL VOC: three bits of a class's number at a time."""
    numbers = np.arange(256)
    colors = np.zeros((256, 3), np.uint8)
    for bit in range(8):
        for channel in range(3):
            colors[:, channel] |= ((numbers >> (3 * bit + channel) & 1) << (7 - bit)).astype(
                np.uint8
            )
    return colors


def encode_palette_png(mask: NDArray[np.uint8]) -> bytes:
    """Return an (H, W) image of classes as a PNG with a palette."""
    from PIL import Image

    image = Image.fromarray(mask, "L")
    image.putpalette(voc_palette().tobytes())
    file = io.BytesIO()
    image.save(file, "PNG")
    return file.getvalue()


def _encode_color(color: NDArray[Any], suffix: str) -> bytes:
    if suffix == "png":
        return encode_image(color)
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(color).save(file, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    return file.getvalue()


def _classes_json(classes: Mapping[int, int], names: Mapping[int, str]) -> str:
    colors = voc_palette().tolist()
    listed = [
        {
            "number": number,
            "name": names.get(label, UNLABELLED),
            "color": colors[number],
            "label_id": label,
        }
        for label, number in classes.items()
    ]
    return json.dumps(listed, indent=2) + "\n"
