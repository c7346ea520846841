"""The check of what a frame says besides distances: normals, time, light, names of objects."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from math import degrees, isclose
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.geometry import pixel_rays
from oaisys_core.types import DEPTH, NORMAL, SceneObject
from oaisys_core.world.batch import DRAWN
from oaisys_dataset.check.report import DatasetFinding
from oaisys_dataset.manifest import FrameRecord, WorldLegend
from oaisys_dataset.reader import DatasetSample

UNIT_TOLERANCE = 1e-3
"""Largest difference of a normal's length from 1."""

SUN_TOLERANCE_DEG = 2e-6
"""Manifests have six digits."""

NEIGHBOURS_DEG = 12.0
"""Angle between a normal and that of the plane through the points of the pixels around it, in the
median of a frame: pixels are coarse, and rough ground is not plane."""

MIN_JUDGED = 50
"""Pixels on smooth surface from which on a frame's normals are judged."""


def normal_faults(sample: DatasetSample) -> Iterator[DatasetFinding]:
    """Yield what is wrong with a frame's normals.

    They must be unit vectors that face the camera where something was hit, 0 elsewhere, and be
    those of the points that depth, the camera matrix and nothing else give in the camera's frame.
    """
    normals, depth_m = sample.arrays.get(NORMAL), sample.arrays.get(DEPTH)
    if normals is None:
        return
    name = f"{sample.record.frame_id}/{NORMAL}"
    length = np.linalg.norm(normals.astype(np.float64), axis=-1)
    wrong = (length != 0) & (np.abs(length - 1) > UNIT_TOLERANCE)
    if wrong.any():
        yield DatasetFinding(
            "surface", name, f"{int(wrong.sum())} normals have another length than 1"
        )
    rays = pixel_rays(sample.record.camera)
    towards = (normals * rays).sum(axis=-1)[length > 0]
    if towards.size and (towards > 0).mean() > 0.01:
        text = f"{(towards > 0).mean():.1%} of its normals point away from the camera"
        yield DatasetFinding("surface", name, text)
    if depth_m is None or not sample.record.camera.is_rectilinear:
        return
    of_surface_m = np.where(np.isfinite(depth_m), depth_m, np.nan)
    off_deg = _off_planes_deg(normals, rays * of_surface_m[..., None])
    if len(off_deg) >= MIN_JUDGED and np.median(off_deg) > NEIGHBOURS_DEG:
        text = f"they are {np.median(off_deg):.0f}° off the surface that its depth shows"
        yield DatasetFinding("surface", name, text)


def draw_faults(record: FrameRecord, draws: Mapping[str, Any]) -> Iterator[DatasetFinding]:
    """Yield how what a record says of its world's drawn values differs from those values."""
    received = record.metadata.get(DRAWN, {})
    # The values of the world as they are after JSON, which knows no tuples.
    expected = json.loads(json.dumps(dict(draws)))
    if received != expected:
        text = f"metadata.{DRAWN} is {received}, expected {expected}"
        yield DatasetFinding("camera", record.frame_id, text)


def _off_planes_deg(normals: NDArray[Any], points_m: NDArray[Any]) -> NDArray[np.float64]:
    """Return angles between normals and those of depth, where depth hardly jumps."""
    right = points_m[1:-1, 2:] - points_m[1:-1, :-2]
    down = points_m[2:, 1:-1] - points_m[:-2, 1:-1]
    with np.errstate(invalid="ignore"):
        of_depth = np.cross(down, right)
        of_depth /= np.linalg.norm(of_depth, axis=-1, keepdims=True)
        z_m = points_m[1:-1, 1:-1, 2]
        is_smooth = np.maximum(np.abs(right[..., 2]), np.abs(down[..., 2])) < 0.05 * z_m
        cosine = np.abs((of_depth * normals[1:-1, 1:-1]).sum(axis=-1))
    judged = cosine[is_smooth & np.isfinite(cosine)]
    return np.asarray(np.degrees(np.arccos(np.clip(judged, 0, 1))))


def light_faults(record: FrameRecord, sun_rad: tuple[float, float]) -> Iterator[DatasetFinding]:
    """Yield how the recorded sun differs from that of the world: elevation and azimuth."""
    recorded = (record.sun_elevation_deg, record.sun_azimuth_deg)
    for field, value, true_rad in zip(
        ("sun_elevation_deg", "sun_azimuth_deg"), recorded, sun_rad, strict=True
    ):
        if value is None:
            continue
        off_deg = (value - degrees(true_rad) + 180) % 360 - 180
        if abs(off_deg) > SUN_TOLERANCE_DEG:
            text = f"{field} is {value:g}, expected {degrees(true_rad):g}"
            yield DatasetFinding("camera", record.frame_id, text)


def time_faults(record: FrameRecord, s_per_view: float) -> Iterator[DatasetFinding]:
    """Yield how a frame's time differs from that of its view."""
    expected_s = record.view * s_per_view
    if not isclose(record.stamp_s, expected_s, abs_tol=1e-9, rel_tol=1e-12):
        text = f"stamp_s is {record.stamp_s}, expected {expected_s}"
        yield DatasetFinding("camera", record.frame_id, text)


def legend_faults(
    world: int, legend: WorldLegend, objects: dict[int, SceneObject]
) -> Iterator[DatasetFinding]:
    """Yield objects of a world whose names, classes or groups its legend does not have."""
    for instance_id, told in legend.instances.items():
        true = objects.get(instance_id)
        wanted = None if true is None else (true.name, true.label, true.kind, true.group)
        if wanted != (told.name, told.label, told.kind, told.group):
            text = f"object {instance_id} is {told.name!r} ({told.label}), expected {wanted}"
            yield DatasetFinding("labels", f"world {world}", text)
            return
    if missing := sorted(objects.keys() - legend.instances.keys()):
        text = f"{len(missing)} objects are not in it, such as {missing[0]}"
        yield DatasetFinding("labels", f"world {world}", text)
