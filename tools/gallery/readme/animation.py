"""An animation of a survey whose mesh grows view by view, from the survey's own bag."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import T_LINK_OPTICAL, pose_looking_at, pose_to_matrix, project
from oaisys_core.types import DEPTH, RGB, FloatArray, Frame, PinholeIntrinsics
from oaisys_mapping.evaluation.visibility import raycasting_scene
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.report.pictures import camera_filled_by, depth_picture, mesh_picture
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume
from oaisys_ros_bridge.bags.recorded.recorded_samples import open_bag

Pixels = NDArray[np.uint8]

SIZE_PX = (960, 400)
SIDE_PX = (256, 192)
"""Size of the images beside the mesh."""

MARGIN_PX, LINE_PX, OVERSAMPLING = 8, 2, 2
MESH_PX = (SIZE_PX[0] - SIDE_PX[0] - 2 * MARGIN_PX, SIZE_PX[1] - 40)
BACKGROUND, INK, ACCENT = (250, 251, 252), (40, 44, 48), (208, 72, 24)
LOOK_FROM = (-0.75, -1.0, 0.85)
"""Where the mesh is looked at from: offset from its centre in units of its diagonal."""

FRUSTUM_DEPTH_M = 4.0
FRAME_MS, LAST_FRAME_MS = 350, 4000


def write_animation(path: Path, survey: Path, quality: int) -> Path:
    """Write the animation of a survey as WebP.

    Args:
        path: File to write.
        survey: Output folder of `oaisys survey`, with its bag and its report.
        quality: Of WebP, 0 to 100.

    Raises:
        InvalidInputError: The folder has no bag of a survey with colour and depth.
    """
    report = json.loads((survey / "report.json").read_text(encoding="utf-8"))
    views = _recorded_views(survey / "bag")
    images = [Image.fromarray(pixels) for pixels in _frames(views, report)]
    durations = [FRAME_MS] * (len(images) - 1) + [LAST_FRAME_MS]
    images[0].save(
        path,
        "WEBP",
        save_all=True,
        append_images=images[1:],
        duration=durations,
        loop=0,
        quality=quality,
        method=6,
    )
    return path


def _recorded_views(bag: Path) -> list[tuple[Frame, Frame]]:
    """Return colour and depth of the first camera for each sample of a bag, in order."""
    samples = open_bag(bag)
    if samples is None:
        raise InvalidInputError("survey", str(bag), "a folder with the bag of a survey")
    views = []
    for sample in samples.read(samples.ids()):
        frames = {frame.modality: frame for frame in reversed(sample.frames)}
        if RGB not in frames or DEPTH not in frames:
            raise InvalidInputError("survey", sorted(frames), "a bag with rgb and depth")
        views.append((frames[RGB], frames[DEPTH]))
    return views


def _frames(views: Sequence[tuple[Frame, Frame]], report: dict[str, Any]) -> Iterator[Pixels]:
    """Yield the animation's pictures: one for each view, and the verdict."""
    meshes = list(_growing_meshes(views, report["voxel_size_m"]))
    camera, T_map_camera = _spectator(meshes[-1])
    for number, (mesh, (rgb, depth)) in enumerate(zip(meshes, views, strict=True), 1):
        image = _mesh_image(mesh, camera, T_map_camera)
        _draw_frustum(image, rgb, camera, T_map_camera)
        yield _page(image, rgb, depth, f"view {number} of {len(views)}")
    image = _mesh_image(meshes[-1], camera, T_map_camera)
    yield _page(image, *views[-1], _verdict(report))


def _growing_meshes(
    views: Sequence[tuple[Frame, Frame]], voxel_size_m: float
) -> Iterator[ColoredMesh]:
    """Yield the mesh after each view."""
    volume = TsdfVolume(TsdfConfig(voxel_size_m=voxel_size_m))
    for rgb, depth in views:
        volume.integrate(depth.data, rgb.data, depth.intrinsics, depth.T_map_camera)
        yield volume.extract_mesh()


def _spectator(mesh: ColoredMesh) -> tuple[PinholeIntrinsics, FloatArray]:
    """Return the camera that sees the whole mesh, and the pose of its optical frame."""
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    middle_m, size_m = (low + high) / 2, float(np.linalg.norm((high - low)[:2]))
    pose = pose_looking_at(middle_m + size_m * np.array(LOOK_FROM), middle_m)
    T_map_camera = pose_to_matrix(pose) @ T_LINK_OPTICAL
    width_px, height_px = (OVERSAMPLING * edge for edge in MESH_PX)
    return camera_filled_by(mesh, T_map_camera, width_px, height_px), T_map_camera


def _mesh_image(mesh: ColoredMesh, camera: PinholeIntrinsics, T_map_camera: FloatArray) -> Pixels:
    scene = raycasting_scene(mesh.vertices_m, mesh.triangles)
    return mesh_picture(mesh, scene, camera, T_map_camera)


def _draw_frustum(
    image: Pixels, view: Frame, camera: PinholeIntrinsics, T_map_camera: FloatArray
) -> None:
    """Draw where a view was taken from, in place."""
    lens = view.intrinsics
    right, down = lens.width_px - 0.5, lens.height_px - 0.5
    corners_px = np.array([(-0.5, -0.5), (right, -0.5), (right, down), (-0.5, down)])
    slopes = (corners_px - (lens.cx_px, lens.cy_px)) / (lens.fx_px, lens.fy_px)
    corners_m = FRUSTUM_DEPTH_M * np.column_stack((slopes, np.ones(4)))
    points_m = np.vstack((np.zeros(3), corners_m)) @ view.T_map_camera[:3, :3].T
    points_m += view.T_map_camera[:3, 3]
    apex, *base = _pixels_of(points_m, camera, T_map_camera)
    lines = [np.array(base), *(np.array((apex, corner)) for corner in base)]
    cv2.polylines(image, lines, True, ACCENT, OVERSAMPLING * LINE_PX, cv2.LINE_AA)


def _pixels_of(
    points_m: FloatArray, camera: PinholeIntrinsics, T_map_camera: FloatArray
) -> NDArray[np.int32]:
    """Return the (N, 2) pixels, rounded, at which a camera sees (N, 3) points in ``map``."""
    camera_m = (points_m - T_map_camera[:3, 3]) @ T_map_camera[:3, :3]
    return np.rint(project(camera_m, camera)).astype(np.int32)


def _page(mesh: Pixels, rgb: Frame, depth: Frame, caption: str) -> Pixels:
    """Return a picture: the mesh with its caption, and the view's colour and depth beside it."""
    page = Image.new("RGB", SIZE_PX, BACKGROUND)
    small = cv2.resize(mesh, MESH_PX, interpolation=cv2.INTER_AREA)
    page.paste(Image.fromarray(small), (0, 0))
    hit_m = depth.data[np.isfinite(depth.data)]
    shown = depth_picture(depth.data, *np.percentile(hit_m, (1, 99)))
    left = SIZE_PX[0] - SIDE_PX[0] - MARGIN_PX
    for row, pixels in enumerate((rgb.data[..., :3], shown)):
        tile = Image.fromarray(pixels).resize(SIDE_PX, Image.Resampling.LANCZOS)
        page.paste(tile, (left, MARGIN_PX // 2 + row * (SIDE_PX[1] + MARGIN_PX)))
    font = ImageFont.load_default(20)
    ImageDraw.Draw(page).text((2 * MARGIN_PX, MESH_PX[1] + 8), caption, INK, font)
    return np.asarray(page, np.uint8)


def _verdict(report: dict[str, Any]) -> str:
    """Return the survey's verdict with its figures."""
    words = "the map agrees with the world" if report["closed"] else "the map is rejected"
    rmse_mm, f_score = 1000 * report["rmse_m"], report["f_score"]
    return f"{report['views']} views, RMSE {rmse_mm:.1f} mm, F-score {f_score:.4f}: {words}"
