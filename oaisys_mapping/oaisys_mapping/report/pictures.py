"""Pictures for reports, drawn without a GPU: meshes, error maps, contact sheets, charts."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

import cv2
import matplotlib as mpl
import numpy as np
import open3d as o3d
from matplotlib.figure import Figure
from numpy.typing import NDArray

from oaisys_core.geometry import T_LINK_OPTICAL, pixel_rays, pose_looking_at, pose_to_matrix
from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_mapping.evaluation.visibility import raycasting_scene
from oaisys_mapping.mesh import ColoredMesh

Image = NDArray[np.uint8]
"""(H, W, 3) uint8 RGB."""

BACKGROUND = (250, 251, 252)
PAGE_COLOR = "#fafbfc"
"""Background colour of the page and of plots."""

LIGHT_DIRECTION = np.array((0.4, 0.35, 0.85)) / np.linalg.norm((0.4, 0.35, 0.85))
THUMBNAIL_WIDTH_PX = 220
OVERSAMPLING = 2
"""Rays along a pixel's edge in pictures of a mesh."""

MARGIN = 0.02
"""Margin around a mesh as a share of the picture's size."""

MESH_SIDES = {
    "from the south-west": ((-0.75, -1.0, 0.75), (1120, 560)),
    "from the east": ((1.2, 0.1, 0.45), (640, 360)),
    "from above": ((0.0, -1e-3, 1.5), (640, 360)),
}
"""Camera offsets from a mesh's centre in units of its diagonal, and picture sizes in pixels."""

LABEL_COLORS: Image = np.array(
    [
        (30, 30, 34),
        (214, 164, 92),
        (94, 129, 172),
        (163, 190, 140),
        (191, 97, 106),
        (180, 142, 173),
        (235, 203, 139),
        (143, 188, 187),
        (208, 135, 112),
        (129, 161, 193),
    ],
    np.uint8,
)
"""Colours of labels in the order of the legend; the first is that of id 0."""


def png(image: Image) -> bytes:
    """Return an image as a PNG file."""
    return _encode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 7])


def jpeg(image: Image) -> bytes:
    """Return an image as a JPEG file, for photographs."""
    return _encode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 88])


def _encode(suffix: str, image: Image, parameters: Sequence[int]) -> bytes:
    _, buffer = cv2.imencode(suffix, np.ascontiguousarray(image[..., ::-1]), parameters)
    return bytes(buffer)


def mesh_views(mesh: ColoredMesh) -> dict[str, Image]:
    """Return shaded pictures of a mesh from several sides, by name."""
    scene = raycasting_scene(mesh.vertices_m, mesh.triangles)
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    middle_m, size_m = (low + high) / 2, float(np.linalg.norm((high - low)[:2]))
    pictures = {}
    for name, (way, (width_px, height_px)) in MESH_SIDES.items():
        pose = pose_looking_at(middle_m + np.array(way) * size_m, middle_m)
        T_map_camera = pose_to_matrix(pose) @ T_LINK_OPTICAL
        camera = camera_filled_by(
            mesh, T_map_camera, width_px * OVERSAMPLING, height_px * OVERSAMPLING
        )
        large = mesh_picture(mesh, scene, camera, T_map_camera)
        small = cv2.resize(large, (width_px, height_px), interpolation=cv2.INTER_AREA)
        pictures[name] = np.asarray(small, np.uint8)
    return pictures


def camera_filled_by(
    mesh: ColoredMesh, T_map_camera: FloatArray, width_px: int, height_px: int
) -> PinholeIntrinsics:
    """Return the camera whose image the mesh just fills, seen from (4, 4) ``T_map_camera``."""
    camera_m = (mesh.vertices_m - T_map_camera[:3, 3]) @ T_map_camera[:3, :3]
    slopes = camera_m[:, :2] / camera_m[:, 2:]
    low, high = slopes.min(axis=0), slopes.max(axis=0)
    size_px = np.array((width_px, height_px))
    focal_px = float((size_px * (1 - 2 * MARGIN) / np.maximum(high - low, 1e-9)).min())
    cx_px, cy_px = (size_px - 1) / 2 - focal_px * (low + high) / 2
    return PinholeIntrinsics(width_px, height_px, focal_px, focal_px, float(cx_px), float(cy_px))


def mesh_picture(
    mesh: ColoredMesh,
    scene: o3d.t.geometry.RaycastingScene,
    camera: PinholeIntrinsics,
    T_map_camera: FloatArray,
) -> Image:
    """Return a shaded picture of a mesh, of which ``scene`` has the triangles."""
    directions = pixel_rays(camera) @ T_map_camera[:3, :3].T
    rays = np.empty((*directions.shape[:2], 6), np.float32)
    rays[..., :3], rays[..., 3:] = T_map_camera[:3, 3], directions
    found = scene.cast_rays(o3d.core.Tensor(rays))
    hit = np.isfinite(found["t_hit"].numpy())
    corners = mesh.triangles[found["primitive_ids"].numpy()[hit]]
    u, v = found["primitive_uvs"].numpy()[hit].T
    a, b, c = (mesh.colors_rgb[corners[:, corner]].astype(np.float32) for corner in range(3))
    colors = (1 - u - v)[:, None] * a + u[:, None] * b + v[:, None] * c
    light = 0.45 + 0.75 * np.abs(
        found["primitive_normals"].numpy()[hit] @ LIGHT_DIRECTION.astype(np.float32)
    )
    image = np.empty((*hit.shape, 3), np.uint8)
    image[:] = BACKGROUND
    image[hit] = np.clip(colors * light[:, None], 0, 255)
    return image


def sheet(images: Sequence[Image], columns: int) -> Image:
    """Return thumbnails of equally sized images in rows of ``columns``, with a thin gap."""
    gap = 4
    height, width = images[0].shape[:2]
    size = (THUMBNAIL_WIDTH_PX, round(THUMBNAIL_WIDTH_PX * height / width))
    rows = -(-len(images) // columns)
    shape = (rows * (size[1] + gap) - gap, columns * (size[0] + gap) - gap, 3)
    page = np.full(shape, 255, np.uint8)
    for index, image in enumerate(images):
        row, column = divmod(index, columns)
        y, x = row * (size[1] + gap), column * (size[0] + gap)
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        page[y : y + size[1], x : x + size[0]] = small
    return page


def depth_picture(depth_m: NDArray[np.float32], near_m: float, far_m: float) -> Image:
    """Return depth in colours from near (yellow) to far (violet), grey where nothing was hit."""
    hit = np.isfinite(depth_m)
    share = np.zeros(depth_m.shape)
    share[hit] = 1 - (depth_m[hit] - near_m) / max(far_m - near_m, 1e-9)
    image = (mpl.colormaps["viridis"](np.clip(share, 0, 1))[..., :3] * 255).astype(np.uint8)
    image[~hit] = 128
    return np.asarray(image, np.uint8)


def depth_scale() -> Image:
    """Return the colours of `depth_picture` from near (left) to far (right)."""
    share = np.linspace(1, 0, 256)
    row = (mpl.colormaps["viridis"](share)[..., :3] * 255).astype(np.uint8)
    return np.repeat(row[None], 8, axis=0)


def semantic_picture(ids: NDArray[np.uint16], labels: Mapping[int, str]) -> Image:
    """Return label ids in the colours of `label_color`."""
    image = np.zeros((*ids.shape, 3), np.uint8)
    for semantic_id in np.unique(ids):
        image[ids == semantic_id] = label_color(int(semantic_id), labels)
    return image


def label_color(semantic_id: int, labels: Mapping[int, str]) -> NDArray[np.uint8]:
    """Return a label's (3,) RGB colour, by its rank among the labels."""
    if semantic_id == 0:
        return np.asarray(LABEL_COLORS[0])
    place = sorted(labels).index(semantic_id) if semantic_id in labels else semantic_id
    return np.asarray(LABEL_COLORS[1 + place % (len(LABEL_COLORS) - 1)])


def instance_picture(ids: NDArray[np.uint32]) -> Image:
    """Return instance ids in colours that differ between consecutive ids; none is near black."""
    hue = (ids.astype(np.float64) * 0.61803398875) % 1.0
    image = (mpl.colormaps["hsv"](hue)[..., :3] * 200 + 40).astype(np.uint8)
    image[ids == 0] = LABEL_COLORS[0]
    return np.asarray(image, np.uint8)


def distance_map(
    points_m: FloatArray, distance_m: FloatArray, cell_m: float, limit_m: float, title: str
) -> bytes:
    """Return a PNG map, seen from above, of the mean distance in each cell."""
    low = points_m[:, :2].min(axis=0)
    cells = np.floor((points_m[:, :2] - low) / cell_m).astype(np.intp)
    shape = tuple(cells.max(axis=0) + 1)
    flat = np.ravel_multi_index(tuple(cells.T), shape)
    count = np.bincount(flat, minlength=np.prod(shape))
    total = np.bincount(flat, distance_m, minlength=np.prod(shape))
    with np.errstate(invalid="ignore"):
        mean_m = (total / count).reshape(shape)
    figure = Figure(figsize=(6.6, 4.2), layout="constrained", facecolor=PAGE_COLOR)
    axes = figure.add_subplot()
    extent = (low[0], low[0] + shape[0] * cell_m, low[1], low[1] + shape[1] * cell_m)
    shown = axes.imshow(
        mean_m.T, origin="lower", extent=extent, cmap="magma_r", vmin=0, vmax=limit_m
    )
    axes.set_facecolor("white")
    axes.set(xlabel="x in metres (map)", ylabel="y in metres (map)")
    axes.set_title(title, fontsize="medium")
    figure.colorbar(shown, label="mean distance in metres", extend="max", shrink=0.85)
    return figure_png(figure)


def time_chart(seconds: Mapping[str, Sequence[float]]) -> bytes:
    """Return a PNG bar chart of the time of each view, stacked by kind of work."""
    figure = Figure(figsize=(10.2, 3.0), layout="constrained", facecolor=PAGE_COLOR)
    axes = figure.add_subplot()
    count = len(next(iter(seconds.values())))
    base = np.zeros(count)
    for name, values in seconds.items():
        median = f"{name}: median {np.median(values):.3g} s"
        axes.bar(np.arange(1, count + 1), values, bottom=base, label=median, width=0.8)
        base += np.asarray(values)
    axes.set(xlabel="view", ylabel="seconds", xlim=(0.3, count + 0.7))
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_facecolor("none")
    axes.margins(y=0.22)
    axes.legend(frameon=False, ncols=len(seconds), loc="upper right")
    return figure_png(figure)


def coverage_chart(
    runs: Sequence[tuple[str, Sequence[float], Sequence[float]]], goal: float
) -> bytes:
    """Return a PNG of coverage against views and against the path flown.

    Args:
        runs: Name, coverage after each view, and metres flown up to each view. Runs whose names
            are equal up to a comma share a colour.
        goal: Coverage that is marked.
    """
    figure = Figure(figsize=(11.2, 3.8), dpi=120, facecolor=PAGE_COLOR, layout="constrained")
    against_views, against_path = figure.subplots(1, 2, sharey=True)
    kinds = list(dict.fromkeys(name.split(",")[0] for name, _, _ in runs))
    for name, coverage, path_m in runs:
        kind = name.split(",")[0]
        style = {"color": f"C{kinds.index(kind)}", "lw": 1.6, "alpha": 0.8}
        against_views.plot(np.arange(1, len(coverage) + 1), np.multiply(coverage, 100), **style)
        against_path.plot(path_m, np.multiply(coverage, 100), **style)
    for index, kind in enumerate(kinds):
        against_views.plot([], [], color=f"C{index}", label=kind)
    against_views.legend(frameon=False)
    against_views.set_ylabel("reachable surface seen, %")
    against_views.set_xlabel("views")
    against_path.set_xlabel("path flown, m")
    for axes in (against_views, against_path):
        axes.set_ylim(0, 100)
        axes.set_xlim(left=0)
        axes.axhline(100 * goal, color="#5b6670", lw=0.8, ls="--")
        axes.grid(alpha=0.3)
        axes.set_facecolor("white")
        axes.spines[["top", "right"]].set_visible(False)
    return figure_png(figure)


def figure_png(figure: Figure) -> bytes:
    """Return a figure as a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130)
    return buffer.getvalue()
