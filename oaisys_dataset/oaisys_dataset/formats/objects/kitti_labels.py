"""Lines of KITTI's object labels: 15 columns for each object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_dataset.formats.objects.selection import ObjectSelection, object_rows

if TYPE_CHECKING:
    from oaisys_dataset.manifest import FrameRecord
    from oaisys_dataset.objects import ObjectRow
    from oaisys_dataset.reader import Dataset

PARTLY, LARGELY = 0.05, 0.5
"""Occlusion from which an object counts as partly (1) and as largely occluded (2)."""

LABEL_COLUMNS = """\
* A line of `label_2` has 15 columns: type, truncated (0 to 1), occluded (0: up to 5 % of the object
  in the image is hidden, 1: up to half, 2: more), alpha, the box in the image (left, top, right,
  bottom: first and last pixel of the whole object within the image, hidden parts included), height,
  width, length (metres: its box along its own z, y and x axis), location (the centre of that box's
  bottom, metres, in the camera's frame: x right, y down, z forward), and rotation_y (the turn about
  y from the camera's x axis to the object's). alpha is rotation_y less the direction to the object.
* The type is the object's label, with `_` for spaces. KITTI has no other turns than rotation_y: of
  an object that tilts against the camera, it is the direction of its x axis, seen along y.
* An object that `min_area` or `min_visible` leaves out is a line `DontCare` with its box."""


def level_rotation(T_map_camera: FloatArray) -> FloatArray:
    """Return the (3, 3) rotation from a camera's frame to the level one: y down, the same heading.

    A camera that looks straight up or down keeps the direction of its upper edge.
    """
    down = -T_map_camera[2, :3]
    forward = np.array((0.0, 0.0, 1.0))
    if abs(down[2]) > 1 - 1e-9:
        forward = np.array((0.0, -np.sign(down[2]), 0.0))
    z = forward - down * (forward @ down)
    z /= np.linalg.norm(z)
    return np.stack((np.cross(down, z), down, z))


def frame_lines(
    dataset: Dataset, record: FrameRecord, selection: ObjectSelection, R_label_camera: FloatArray
) -> list[str]:
    """Return the lines of a frame; see `label_lines`.

    Raises:
        InvalidInputError: Its world has no table of objects.
    """
    rows = object_rows(dataset, record, "objects")
    chosen = selection.choose(record, {row.instance_id: row.visible_px for row in rows})
    return label_lines(rows, chosen, record.camera, R_label_camera)


def label_lines(
    rows: Sequence[ObjectRow],
    chosen: set[int],
    camera: PinholeIntrinsics,
    R_label_camera: FloatArray,
) -> list[str]:
    """Return the lines of a frame's objects.

    Args:
        rows: The objects.
        chosen: Ids of those that count; the others are ``DontCare``.
        camera: The camera.
        R_label_camera: (3, 3) rotation from the camera's frame to that of the labels.
    """
    lines = []
    for row in rows:
        box = _box_in_image(row, camera)
        if row.instance_id in chosen:
            lines.append(_line(row, box, R_label_camera))
        else:
            lines.append(f"DontCare -1 -1 -10 {box} -1 -1 -1 -1000 -1000 -1000 -10")
    return lines


def _line(row: ObjectRow, box: str, R_label_camera: FloatArray) -> str:
    T = row.T_camera_object
    bottom_m = row.box_center_object_m - (0.0, 0.0, row.size_m[2] / 2)
    x, y, z = R_label_camera @ (T[:3, :3] @ bottom_m + T[:3, 3])
    heading = R_label_camera @ T[:3, 0]
    rotation_y = float(np.arctan2(-heading[2], heading[0]))
    alpha = _wrap(rotation_y - float(np.arctan2(x, z)))
    occluded = 0 if row.occlusion <= PARTLY else 1 if row.occlusion <= LARGELY else 2
    length, width, height = row.size_m
    values = (height, width, length, x, y, z, rotation_y)
    name = "_".join(row.label.split()) or "Misc"
    truncated = max(0.0, row.truncation or 0.0)
    told = " ".join(f"{value:.6f}" for value in values)
    return f"{name} {truncated:.4f} {occluded} {alpha:.6f} {box} {told}"


def _box_in_image(row: ObjectRow, camera: PinholeIntrinsics) -> str:
    left, top, width, height = row.box_amodal_px
    right, bottom = min(left + width, camera.width_px) - 1, min(top + height, camera.height_px) - 1
    return f"{max(left, 0):.2f} {max(top, 0):.2f} {right:.2f} {bottom:.2f}"


def _wrap(angle_rad: float) -> float:
    """Return an angle between -pi and pi."""
    return float((angle_rad + np.pi) % (2 * np.pi) - np.pi)
