"""The table of a world's objects: a row for each frame and object that shows in it.

``shards/world_000012.objects.parquet`` has the columns of `SCHEMA`; worlds whose cameras render no
``instance`` have none. Its footer holds a hash of its rows.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray, ShortRepr
from oaisys_dataset.object_values import check_values, read_rows

if TYPE_CHECKING:
    from oaisys_core.raycast.objects.views import ObjectViews
    from oaisys_dataset.manifest import FrameRecord, WorldLegend

HASH_KEY = b"rows_sha256"

_MATRIX = pa.list_(pa.list_(pa.float64(), 4), 4)
_CORNERS = pa.list_(pa.list_(pa.float64(), 3), 8)
_BOX = pa.list_(pa.int64(), 4)

COLUMNS: Mapping[str, tuple[pa.DataType, str]] = {
    "frame_id": (pa.string(), "the frame"),
    "world": (pa.int64(), "index of the world"),
    "view": (pa.int64(), "index of the view in its world"),
    "sensor": (pa.string(), "name of the camera"),
    "instance_id": (pa.uint32(), "id of the object in its world, as in `instance`"),
    "name": (pa.string(), "unique name of the object in its world"),
    "label": (pa.string(), "its class on level 0"),
    "semantic_id": (pa.uint16(), "id of its class, as in `semantic_0`"),
    "mesh_sha256": (pa.string(), "hash of its shape at a scale of 1; equal shapes have equal ones"),
    "scale": (pa.float64(), "factor on its shape"),
    "T_map_object": (_MATRIX, "4x4 rigid pose of the object's frame in map, m"),
    "T_camera_object": (_MATRIX, "4x4 rigid pose of the object's frame in the camera's frame, m"),
    "size_m": (pa.list_(pa.float64(), 3), "edges of its box along its own x, y and z, m"),
    "box_center_object_m": (pa.list_(pa.float64(), 3), "centre of its box in its own frame, m"),
    "corners_map_m": (_CORNERS, "8 corners of its box in map, by x, then y, then z, m"),
    "corners_camera_m": (_CORNERS, "the same in the camera's frame, m"),
    "diameter_m": (pa.float64(), "largest distance of two of its points, m"),
    "distance_m": (pa.float64(), "from the camera to the centre of its box, m"),
    "visible_px": (pa.int64(), "pixels that show it"),
    "silhouette_px": (pa.int64(), "pixels that it alone would cover, in the image or beyond it"),
    "silhouette_in_image_px": (pa.int64(), "those of them that are in the image"),
    "box_visible_px": (
        _BOX,
        "left, top, width, height of what shows, from the image's corner",
    ),
    "box_amodal_px": (_BOX, "the same of its silhouette; it may go on beyond the image"),
    "visible_share": (pa.float64(), "visible_px / silhouette_px"),
    "occlusion": (pa.float64(), "share of silhouette_in_image_px that other things hide"),
    "truncation": (pa.float64(), "share of silhouette_px beyond the image; null for a fisheye"),
}
"""Type and meaning of each column; frames and units are in the names."""

SCHEMA = pa.schema([(name, kind) for name, (kind, _) in COLUMNS.items()])


def frame_objects(record: FrameRecord, views: ObjectViews) -> pa.RecordBatch:
    """Return the rows of a frame; ``name`` and ``label`` are empty, see `with_names`."""
    n = len(views.instance_ids)
    T_camera_map = np.linalg.inv(record.pose)
    T_camera_object = T_camera_map @ views.T_map_object
    corners = _corners(views)
    centers = (views.low_m + views.high_m) / 2
    in_image = views.silhouette_in_image_px
    truncation = 1 - in_image / views.silhouette_px
    is_fisheye = record.camera.is_fisheye
    values = {
        "frame_id": [record.frame_id] * n,
        "world": [record.world] * n,
        "view": [record.view] * n,
        "sensor": [record.sensor] * n,
        "instance_id": views.instance_ids,
        "name": [""] * n,
        "label": [""] * n,
        "semantic_id": views.semantic_ids,
        "mesh_sha256": list(views.mesh_sha256),
        "scale": views.scale,
        "T_map_object": views.T_map_object,
        "T_camera_object": T_camera_object,
        "size_m": views.high_m - views.low_m,
        "box_center_object_m": centers,
        "corners_map_m": _transform(views.T_map_object, corners),
        "corners_camera_m": _transform(T_camera_object, corners),
        "diameter_m": views.diameter_m,
        "distance_m": np.linalg.norm(_transform(T_camera_object, centers[:, None])[:, 0], axis=1),
        "visible_px": views.visible_px,
        "silhouette_px": views.silhouette_px,
        "silhouette_in_image_px": in_image,
        "box_visible_px": views.box_visible_px,
        "box_amodal_px": views.box_amodal_px,
        "visible_share": views.visible_px / views.silhouette_px,
        "occlusion": 1 - views.visible_px / in_image,
        "truncation": [None] * n if is_fisheye else truncation,
    }
    columns = [_column(values[field.name], field.type) for field in SCHEMA]
    return pa.RecordBatch.from_arrays(columns, schema=SCHEMA)


def with_names(table: pa.Table, legend: WorldLegend) -> pa.Table:
    """Return a table with the names and labels of a world's legend."""
    known = legend.instances
    ids = table["instance_id"].to_pylist()
    for column, values in (
        ("name", [known[i].name if i in known else "" for i in ids]),
        ("label", [known[i].label if i in known else "" for i in ids]),
    ):
        place = table.schema.get_field_index(column)
        table = table.set_column(place, column, pa.array(values, pa.string()))
    return table


def encode_objects(frames: Iterable[pa.RecordBatch], legend: WorldLegend) -> bytes:
    """Return the file of a world's table; inverse: `decode_objects`."""
    table = with_names(pa.Table.from_batches(list(frames), SCHEMA), legend)
    table = table.replace_schema_metadata({HASH_KEY: rows_sha256(table).encode()})
    file = io.BytesIO()
    pq.write_table(table, file, compression="zstd")
    return file.getvalue()


def decode_objects(file: bytes, name: str) -> pa.Table:
    """Return the table of a file's bytes; errors call it ``name``.

    Raises:
        InvalidInputError: It is no such table, too large, or has values that no world has.
    """
    try:
        table = read_rows(file, name, SCHEMA)
    except (pa.ArrowException, OSError) as error:
        raise InvalidInputError(name, f"{len(file)} bytes", f"a Parquet file ({error})") from error
    check_values(table, name)
    return table


def check_legend(table: pa.Table, legend: WorldLegend, name: str) -> None:
    """Raise at the first object of a table that a world's legend does not know by this name.

    Raises:
        InvalidInputError: Says which object, and what the legend says.
    """
    found = table.select(["instance_id", "name", "label"]).group_by(
        ["instance_id", "name", "label"]
    )
    for row in found.aggregate([]).to_pylist():
        known = legend.instances.get(row["instance_id"])
        if known is None:
            expected = "ids that the legend of the world names"
            raise InvalidInputError(f"{name}: instance_id", row["instance_id"], expected)
        if (row["name"], row["label"]) != (known.name, known.label):
            field = f"{name}: object {row['instance_id']}"
            received = f"{row['name']!r}, {row['label']!r}"
            expected = f"{known.name!r}, {known.label!r}, as the legend of the world says"
            raise InvalidInputError(field, received, expected)


def is_intact(table: pa.Table) -> bool:
    """Return whether a table that was read has the hash of its rows."""
    recorded = (table.schema.metadata or {}).get(HASH_KEY, b"").decode("ascii", "replace")
    return bool(recorded == rows_sha256(table))


def rows_sha256(table: pa.Table) -> str:
    """Return the hash of a table's rows."""
    digest = hashlib.sha256()
    for name in SCHEMA.names:
        digest.update(f"{name} {len(table)}\n".encode())
        digest.update(_bytes(table[name].combine_chunks()))
    return digest.hexdigest()


def _bytes(column: Any) -> bytes:
    """Return the values of an Arrow array as bytes; little-endian, null is NaN."""
    while pa.types.is_fixed_size_list(column.type):
        column = column.flatten()
    if pa.types.is_string(column.type):
        return "\n".join(column.to_pylist()).encode()
    values = column.to_numpy(zero_copy_only=False)
    return bytes(values.astype(values.dtype.newbyteorder("<")).tobytes())


@dataclass(frozen=True, repr=False)
class ObjectRow(ShortRepr):
    """An object that shows in a frame; see `COLUMNS` for what each field means."""

    instance_id: int
    name: str
    label: str
    semantic_id: int
    mesh_sha256: str
    scale: float
    T_map_object: FloatArray
    T_camera_object: FloatArray
    size_m: FloatArray
    box_center_object_m: FloatArray
    corners_map_m: FloatArray
    corners_camera_m: FloatArray
    diameter_m: float
    distance_m: float
    visible_px: int
    silhouette_px: int
    silhouette_in_image_px: int
    box_visible_px: tuple[int, int, int, int]
    box_amodal_px: tuple[int, int, int, int]
    visible_share: float
    occlusion: float
    truncation: float | None


def rows_of_frame(table: pa.Table, frame_id: str) -> list[ObjectRow]:
    """Return the rows of one frame as objects."""
    return rows_of(table.filter(pc.equal(table["frame_id"], frame_id)))


def rows_of(table: pa.Table) -> list[ObjectRow]:
    """Return the rows of a table as objects."""
    names = [each.name for each in fields(ObjectRow)]
    rows = []
    for data in table.select(names).to_pylist():
        for name, value in data.items():
            if isinstance(value, list):
                is_box = name.startswith("box_") and name.endswith("_px")
                data[name] = tuple(value) if is_box else np.array(value)
        rows.append(ObjectRow(**data))
    return rows


def _corners(views: ObjectViews) -> FloatArray:
    """Return the (N, 8, 3) corners of the boxes in the objects' frames."""
    unit = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    size_m = views.high_m - views.low_m
    return np.asarray(views.low_m[:, None] + unit * size_m[:, None])


def _transform(T: FloatArray, points: FloatArray) -> FloatArray:
    """Return (N, P, 3) points in other frames by (N, 4, 4) poses."""
    return np.asarray(np.einsum("nij,npj->npi", T[:, :3, :3], points) + T[:, None, :3, 3])


def _column(values: Any, kind: pa.DataType) -> pa.Array:
    if pa.types.is_fixed_size_list(kind) and isinstance(values, np.ndarray):
        inner = _column(values.reshape(-1, *values.shape[2:]), kind.value_type)
        return pa.FixedSizeListArray.from_arrays(inner, kind.list_size)
    return pa.array(values, kind)
