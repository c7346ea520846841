"""frames.csv of a data set: a row for each frame with its camera, its pose and the sun."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from typing import TYPE_CHECKING

from oaisys_core.geometry import pose_from_matrix

if TYPE_CHECKING:
    from oaisys_dataset.manifest import FrameRecord

FRAMES = "frames.csv"

COLUMNS = {
    "frame_id": "name of the frame in the manifest",
    "split": "train, val, test or another name",
    "world": "index of the world",
    "view": "index of the view in its world",
    "sensor": "name of the camera",
    "stamp_s": "simulated time of the view in its world, s",
    "width_px": "width of the images, px",
    "height_px": "height of the images, px",
    "fx_px": "focal length along x, px",
    "fy_px": "focal length along y, px",
    "cx_px": "principal point, px; the centre of the first pixel is 0",
    "cy_px": "principal point, px; the centre of the first pixel is 0",
    "x_m": "position of the camera in map, m",
    "y_m": "position of the camera in map, m",
    "z_m": "position of the camera in map, m",
    "qx": "rotation of the camera's frame (x right, y down, z forward) in map",
    "qy": "rotation of the camera's frame in map",
    "qz": "rotation of the camera's frame in map",
    "qw": "rotation of the camera's frame in map, real part",
    "sun_elevation_deg": "elevation of the sun, degrees; empty if it is not known",
    "sun_azimuth_deg": "azimuth of the sun in map from x towards y, degrees; empty if not known",
}
"""Meaning of each column by its name."""


def frames_table(records: Iterable[FrameRecord]) -> bytes:
    """Return the content of frames.csv."""
    text = io.StringIO()
    table = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    table.writeheader()
    table.writerows(_row(record) for record in records)
    return text.getvalue().encode()


def _row(record: FrameRecord) -> dict[str, object]:
    camera = record.intrinsics
    pose = pose_from_matrix(record.T_map_camera)
    return {
        "frame_id": record.frame_id,
        "split": record.split,
        "world": record.world,
        "view": record.view,
        "sensor": record.sensor,
        "stamp_s": record.stamp_s,
        **{name: camera[name] for name in COLUMNS if name.endswith("_px")},
        **dict(zip(("x_m", "y_m", "z_m"), pose.position_m, strict=True)),
        **dict(zip(("qx", "qy", "qz", "qw"), pose.quat_xyzw, strict=True)),
        "sun_elevation_deg": record.sun_elevation_deg,
        "sun_azimuth_deg": record.sun_azimuth_deg,
    }
