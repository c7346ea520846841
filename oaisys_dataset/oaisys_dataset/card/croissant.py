"""croissant.json: metadata of a data set for programs (https://mlcommons.org/croissant)."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

from oaisys_dataset.card.frames_table import COLUMNS, FRAMES
from oaisys_dataset.card.statistics import number_of

if TYPE_CHECKING:
    import mlcroissant

    from oaisys_dataset.card.statistics import DatasetStatistics

CROISSANT = "croissant.json"

CONFORMS_TO = "http://mlcommons.org/croissant/1.0"
WHOLE = ("world", "view", "width_px", "height_px")
TEXT = ("frame_id", "split", "sensor")


def croissant_text(
    name: str, statistics: DatasetStatistics, frames: bytes, license_name: str
) -> str:
    """Return the JSON-LD text of croissant.json.

    Args:
        name: Name of the format.
        statistics: Of the data set.
        frames: Content of frames.csv, whose columns are the fields of the record set.
        license_name: Licence of the data set; empty if the owner gave none.
    """
    import mlcroissant

    table = mlcroissant.FileObject(
        id=FRAMES,
        name=FRAMES,
        description="A row for each frame: camera, pose, sun.",
        content_url=FRAMES,
        encoding_formats=["text/csv"],
        sha256=hashlib.sha256(frames).hexdigest(),
    )
    records = mlcroissant.RecordSet(
        id="frames",
        name="frames",
        description="The frames of all splits.",
        key=["frames/frame_id"],
        fields=[_field(column, meaning) for column, meaning in COLUMNS.items()],
    )
    metadata = mlcroissant.Metadata(
        name=f"oaisys-terrain-{name}",
        description=_description(statistics),
        conforms_to=[CONFORMS_TO],
        license=[license_name] if license_name else None,
        distribution=[table],
        record_sets=[records],
    )
    return json.dumps(metadata.to_json(), indent=2, default=str) + "\n"


def _field(column: str, meaning: str) -> mlcroissant.Field:
    import mlcroissant

    types = mlcroissant.DataType
    kind: Any = types.FLOAT
    if column in TEXT:
        kind = types.TEXT
    elif column in WHOLE:
        kind = types.INTEGER
    return mlcroissant.Field(
        id=f"frames/{column}",
        name=column,
        description=meaning,
        data_types=[kind],
        source=mlcroissant.Source(file_object=FRAMES, extract=mlcroissant.Extract(column=column)),
    )


def _description(statistics: DatasetStatistics) -> str:
    splits = ", ".join(
        f"{split}: {number_of(count, 'frame')} of {number_of(statistics.worlds[split], 'world')}"
        for split, count in statistics.frames.items()
    )
    images = ", ".join(statistics.modalities)
    return (
        f"Terrain rendered by OAISYS ({splits}) with {images}. Depth is planar z in metres. "
        "README.md states all conventions."
    )
