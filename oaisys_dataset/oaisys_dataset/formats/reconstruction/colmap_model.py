"""COLMAP's model files: cameras, images and points, as text or binary.

COLMAP's pixels have their origin at the upper left corner of the image, ours at the centre of the
first pixel, so that half a pixel is added to principal points and observations. Its poses are
those of the world in the camera's frame, with quaternions (w, x, y, z).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.geometry import invert, pose_from_matrix
from oaisys_core.output.files import write_bytes, write_text
from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_dataset.formats.reconstruction.depth_points import DepthPoints
from oaisys_dataset.formats.trajectories.sequences import numbers

PIXEL_CENTRE_PX = 0.5
"""Place of the first pixel's centre in COLMAP's (and nerfstudio's) images."""

MODEL_IDS = {"PINHOLE": 1, "OPENCV": 4, "OPENCV_FISHEYE": 5, "FULL_OPENCV": 6}
ERROR_PX = 0.0
"""Reprojection error of every point: it is the true surface."""


class ColmapImage(NamedTuple):
    """One picture; ``camera`` is its place in the list of cameras."""

    name: str
    camera: int
    T_map_camera: FloatArray


class ColmapModel(NamedTuple):
    """A reconstruction; ``points`` has observations for each image, in their order.

    Identifiers in the files are places in these lists, counted from 1.
    """

    cameras: Sequence[PinholeIntrinsics]
    images: Sequence[ColmapImage]
    points: DepthPoints


def camera_model(intrinsics: PinholeIntrinsics) -> tuple[str, list[float]]:
    """Return name and parameters of COLMAP's model for a camera."""
    centre = (intrinsics.cx_px + PIXEL_CENTRE_PX, intrinsics.cy_px + PIXEL_CENTRE_PX)
    parameters = [intrinsics.fx_px, intrinsics.fy_px, *centre]
    if intrinsics.is_fisheye:
        return "OPENCV_FISHEYE", [*parameters, *(intrinsics.distortion or (0.0,) * 4)]
    if intrinsics.is_rectilinear:
        return "PINHOLE", parameters
    k1, k2, p1, p2, k3 = intrinsics.distortion
    if k3 == 0:
        return "OPENCV", [*parameters, k1, k2, p1, p2]
    return "FULL_OPENCV", [*parameters, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]


def write_model(folder: Path, model: ColmapModel, *, as_text: bool) -> None:
    """Write the three files of a model into a folder.

    Raises:
        RenderError: One could not be written.
    """
    if as_text:
        write_text(folder / "cameras.txt", "".join(_camera_lines(model)))
        write_text(folder / "images.txt", "".join(_image_lines(model)))
        write_text(folder / "points3D.txt", "".join(_point_lines(model)))
    else:
        write_bytes(folder / "cameras.bin", _camera_bytes(model))
        write_bytes(folder / "images.bin", _image_bytes(model))
        write_bytes(folder / "points3D.bin", _point_bytes(model))


def _camera_lines(model: ColmapModel) -> list[str]:
    lines = ["# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n"]
    for number, camera in enumerate(model.cameras, 1):
        name, parameters = camera_model(camera)
        size = f"{camera.width_px} {camera.height_px}"
        lines.append(f"{number} {name} {size} {numbers(parameters)}\n")
    return lines


def _image_lines(model: ColmapModel) -> list[str]:
    lines = ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then X Y POINT3D_ID of each point\n"]
    for number, image in enumerate(model.images, 1):
        pixels, seen = _observations(model, number - 1)
        lines.append(f"{number} {numbers(_pose(image))} {image.camera + 1} {image.name}\n")
        triples = zip(pixels.tolist(), seen.tolist(), strict=True)
        lines.append(" ".join(f"{numbers(pixel)} {point}" for pixel, point in triples) + "\n")
    return lines


def _point_lines(model: ColmapModel) -> list[str]:
    lines = ["# POINT3D_ID X Y Z R G B ERROR TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"]
    points, tracks = model.points, _tracks(model.points)
    for row, (point_m, color) in enumerate(zip(points.points_m, points.rgb, strict=True)):
        rgb = " ".join(map(str, color.tolist()))
        track = " ".join(map(str, tracks[row].ravel().tolist()))
        lines.append(f"{row + 1} {numbers(point_m)} {rgb} {ERROR_PX} {track}\n")
    return lines


def _camera_bytes(model: ColmapModel) -> bytes:
    parts = [struct.pack("<Q", len(model.cameras))]
    for number, camera in enumerate(model.cameras, 1):
        name, parameters = camera_model(camera)
        head = (number, MODEL_IDS[name], camera.width_px, camera.height_px)
        parts.append(struct.pack(f"<IiQQ{len(parameters)}d", *head, *parameters))
    return b"".join(parts)


def _image_bytes(model: ColmapModel) -> bytes:
    layout = np.dtype([("pixel", "<f8", 2), ("point", "<u8")])
    parts = [struct.pack("<Q", len(model.images))]
    for number, image in enumerate(model.images, 1):
        pixels, seen = _observations(model, number - 1)
        observations = np.empty(len(seen), layout)
        observations["pixel"], observations["point"] = pixels, seen
        head = struct.pack("<I7dI", number, *_pose(image), image.camera + 1)
        name = image.name.encode() + b"\0"
        parts += [head, name, struct.pack("<Q", len(seen)), observations.tobytes()]
    return b"".join(parts)


def _point_bytes(model: ColmapModel) -> bytes:
    points = model.points
    parts = [struct.pack("<Q", len(points.points_m))]
    for row, track in enumerate(_tracks(points)):
        colored = (*points.points_m[row].tolist(), *points.rgb[row].tolist())
        head = struct.pack("<Q3d3BdQ", row + 1, *colored, ERROR_PX, len(track))
        parts += [head, track.astype("<u4").tobytes()]
    return b"".join(parts)


def _pose(image: ColmapImage) -> list[float]:
    """Return quaternion (w, x, y, z) and translation of the world in the camera's frame."""
    T_camera_map = pose_from_matrix(invert(image.T_map_camera))
    x, y, z, w = T_camera_map.quat_xyzw
    return [w, x, y, z, *T_camera_map.position_m]


def _observations(model: ColmapModel, index: int) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return pixels and point identifiers of an image's observations."""
    return model.points.pixels[index] + PIXEL_CENTRE_PX, model.points.seen[index] + 1


def _tracks(points: DepthPoints) -> list[NDArray[Any]]:
    """Return, for each point, its (L, 2) image identifiers and places in their observations."""
    if not len(points.points_m):
        return []
    seen = np.concatenate(points.seen)
    image = np.repeat(np.arange(len(points.seen)) + 1, [len(each) for each in points.seen])
    place = np.concatenate([np.arange(len(each)) for each in points.seen])
    order = np.argsort(seen, kind="stable")
    pairs = np.column_stack((image, place))[order]
    counts = np.bincount(seen, minlength=len(points.points_m))
    return np.split(pairs, np.cumsum(counts)[:-1])
