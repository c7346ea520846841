"""The check of a world's table of objects against its images and its legend."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import OaisysError
from oaisys_core.types import INSTANCE
from oaisys_dataset.check.report import ShardResult
from oaisys_dataset.manifest import FrameRecord, WorldLegend
from oaisys_dataset.objects import ObjectRow, decode_objects, is_intact, rows_of
from oaisys_dataset.places import StoragePlace
from oaisys_dataset.shards import SHARDS, objects_name

CHECK = "objects"
"""Name of this check in findings."""

POSE_TOLERANCE = 1e-6
"""Largest difference of a number in a pose, or of a length in metres."""

SILHOUETTE_TOLERANCE = 0.02
"""Share by which a silhouette may differ: rays along an edge hit or miss by rounding."""

# How the fields of a row are compared: as they are, within a tolerance, or as silhouettes.
SAME = ("mesh_sha256", "semantic_id", "box_visible_px")
CLOSE = (
    *("T_map_object", "scale", "size_m", "box_center_object_m"),
    *("corners_map_m", "corners_camera_m", "diameter_m", "distance_m"),
)
PIXELS = ("silhouette_px", "silhouette_in_image_px")


class ObjectRowsCheck:
    """Compares the rows of a world's table with its frames, one frame after the other."""

    def __init__(
        self,
        place: StoragePlace,
        records: Sequence[FrameRecord],
        legend: WorldLegend,
        result: ShardResult,
    ) -> None:
        """Read the table of a world; the findings about the whole of it are noted."""
        self._legend = legend
        self._result = result
        self._rows: dict[str, list[ObjectRow]] = {}
        self._has_table = False
        name = objects_name(result.world)
        with_ids = {record.frame_id for record in records if INSTANCE in record.images}
        if not place.exists(name):
            # Data sets of earlier versions have no tables at all.
            if with_ids and any(each.endswith(".parquet") for each in place.names(SHARDS)):
                result.note(CHECK, name, "it is missing; other worlds have theirs")
            return
        try:
            table = decode_objects(place.read(name), name)
        except OaisysError as error:
            result.note(CHECK, name, str(error))
            return
        self._has_table = True
        if not is_intact(table):
            result.note(CHECK, name, "its rows were changed: their hash differs")
        frames = table["frame_id"].to_pylist()
        for frame_id, row in zip(frames, rows_of(table), strict=True):
            self._rows.setdefault(frame_id, []).append(row)
        for frame_id in sorted(self._rows.keys() - with_ids):
            result.note(CHECK, frame_id, "the table has rows of this frame, which has no ids")

    def check(self, record: FrameRecord, instance: NDArray[Any]) -> None:
        """Compare the rows of a frame with its image of object ids."""
        if not self._has_table:
            return
        rows = self._rows.get(record.frame_id, [])
        ids, counts = np.unique(instance[instance > 0], return_counts=True)
        shown = dict(zip(ids.tolist(), counts.tolist(), strict=True))
        found = {row.instance_id: row for row in rows}
        if len(found) < len(rows) or found.keys() != shown.keys():
            text = f"rows of the objects {sorted(found)[:5]}, the image shows {sorted(shown)[:5]}"
            self._result.note(CHECK, record.frame_id, text)
        T_camera_map = np.linalg.inv(record.pose)
        for instance_id in sorted(found.keys() & shown.keys()):
            wrong = self._wrong(found[instance_id], shown[instance_id], T_camera_map)
            if wrong:
                self._result.note(CHECK, f"{record.frame_id}/{instance_id}", wrong)

    def _wrong(
        self, row: ObjectRow, visible_px: int, T_camera_map: NDArray[np.float64]
    ) -> str | None:
        """Return what is wrong with a row, if anything."""
        named = self._legend.instances.get(row.instance_id)
        if named is None or (row.name, row.label) != (named.name, named.label):
            return f"{row.name!r}, {row.label!r} is not what the legend says"
        if row.visible_px != visible_px:
            return f"visible_px is {row.visible_px}, the image has {visible_px}"
        if not np.allclose(
            T_camera_map @ row.T_map_object, row.T_camera_object, rtol=0, atol=POSE_TOLERANCE
        ):
            return "T_camera_object is not T_map_object seen from the camera"
        if not row.visible_px <= row.silhouette_in_image_px <= row.silhouette_px:
            return "a part of its silhouette is larger than the whole"
        return None


def differing_rows(rows: Sequence[ObjectRow], wanted: Sequence[ObjectRow]) -> Iterator[str]:
    """Yield how rows of a frame differ from those that the world gives."""
    by_id = {row.instance_id: row for row in rows}
    for true in wanted:
        row = by_id.get(true.instance_id)
        if row is None:
            continue
        for name in _differences(row, true):
            received, expected = getattr(row, name), getattr(true, name)
            yield f"object {row.instance_id}: {name} is {received}, the world has {expected}"


def _differences(row: ObjectRow, true: ObjectRow) -> Iterator[str]:
    """Yield the names of the fields that differ."""
    for name in SAME:
        if getattr(row, name) != getattr(true, name):
            yield name
    for name in CLOSE:
        if not np.allclose(getattr(row, name), getattr(true, name), rtol=0, atol=POSE_TOLERANCE):
            yield name
    for name in PIXELS:
        off = abs(getattr(row, name) - getattr(true, name))
        if off > 4 + SILHOUETTE_TOLERANCE * getattr(true, name):
            yield name
    if np.abs(np.subtract(row.box_amodal_px, true.box_amodal_px)).max() > 2:
        yield "box_amodal_px"
    for name, share in _shares(row).items():
        if getattr(row, name) != share:
            yield name


def _shares(row: ObjectRow) -> dict[str, float | None]:
    """Return the shares that follow from a row's numbers of pixels."""
    outside = 1 - row.silhouette_in_image_px / row.silhouette_px
    return {
        "visible_share": row.visible_px / row.silhouette_px,
        "occlusion": 1 - row.visible_px / row.silhouette_in_image_px,
        "truncation": None if row.truncation is None else outside,
    }
