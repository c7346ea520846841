"""The mesh in a report: decimated, with layers of colours, packed_mesh for JavaScript."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from oaisys_core.geometry import transform_points, unproject
from oaisys_core.types import FloatArray
from oaisys_mapping.evaluation.evaluate import Evaluation
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.mesh import ColoredMesh, triangle_areas_m2
from oaisys_mapping.report import pictures

MAX_TRIANGLES = 400_000
"""Triangles in a page: some 4 MB, which a browser can turn without a GPU."""

CELL_GROWTH = 1.15
"""Factor by which clustering cells grow until a mesh is small enough."""

FRUSTUM_SHARE = 0.02
"""Length of a drawn camera frustum, as a share of the mesh's diagonal."""

STEPS = 65535
"""Quantization steps of positions along each side of the mesh's bounding box."""


IMAGE_SHADING = 0.3
"""Share of shading for colours from images, which contain light and shadow already."""


@dataclass(frozen=True)
class Layer:
    """One colouring of a mesh.

    Attributes:
        title: Title of its button.
        note: Meaning of the colours.
        colors_rgb: (V, 3) uint8 colours of the vertices.
        shaded: Share of shading, 0 to 1.
    """

    title: str
    note: str
    colors_rgb: NDArray[np.uint8]
    shaded: float = 1.0


def layers_of(mesh: ColoredMesh, evaluation: Evaluation, labels: Mapping[int, str]) -> list[Layer]:
    """Return the layers of a mesh: image colours, errors and, if it has them, classes."""
    note = "Colours from the images."
    layers = [Layer("colour", note, mesh.colors_rgb, IMAGE_SHADING), _errors(mesh, evaluation)]
    if mesh.class_ids is not None:
        ids = mesh.class_ids[None]
        note = "The most frequent class, in the colours of the label images."
        layers.append(Layer("classes", note, pictures.semantic_picture(ids, labels)[0]))
    return layers


def _errors(mesh: ColoredMesh, evaluation: Evaluation) -> Layer:
    """Colour each vertex by the distance to the truth measured nearest to it."""
    limit_m = evaluation.metrics.voxel_size_m / 2
    place = nearest(evaluation.reconstruction.points_m, mesh.vertices_m)
    share = np.minimum(evaluation.reconstruction_distance_m[place] / limit_m, 1.0)
    colors_rgb = (mpl.colormaps["magma_r"](share)[:, :3] * 255).astype(np.uint8)
    far = f"half a voxel, {100 * limit_m:.3g} cm, and above (black)"
    note = f"Distance to the true surface, from 0 (pale) to {far}."
    return Layer("error", note, colors_rgb, 0.6)


def decimate(mesh: ColoredMesh, max_triangles: int = MAX_TRIANGLES) -> ColoredMesh:
    """Return a mesh of at most ``max_triangles``, by Open3D's vertex clustering.

    New vertices take the class of the nearest old one.
    """
    if len(mesh.triangles) <= max_triangles:
        return mesh
    original = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices_m), o3d.utility.Vector3iVector(mesh.triangles)
    )
    original.vertex_colors = o3d.utility.Vector3dVector(mesh.colors_rgb / 255.0)
    area_m2 = float(triangle_areas_m2(mesh.vertices_m, mesh.triangles).sum())
    # A grid has two triangles per square cell.
    cell_m = np.sqrt(2 * area_m2 / max_triangles)
    clustered = original.simplify_vertex_clustering(cell_m)
    while len(clustered.triangles) > max_triangles:
        cell_m *= CELL_GROWTH
        clustered = original.simplify_vertex_clustering(cell_m)
    vertices_m = np.asarray(clustered.vertices)
    colors_rgb = np.rint(np.asarray(clustered.vertex_colors) * 255).astype(np.uint8)
    class_ids = None
    if mesh.class_ids is not None:
        class_ids = mesh.class_ids[nearest(mesh.vertices_m, vertices_m)]
    return ColoredMesh(
        vertices_m, np.asarray(clustered.triangles).astype(np.int32), colors_rgb, class_ids
    )


def nearest(points_m: FloatArray, wanted_m: FloatArray) -> NDArray[np.intp]:
    """Return the (M,) indices of the (N, 3) points nearest to (M, 3) others."""
    return np.asarray(cKDTree(points_m).query(wanted_m)[1])


def pack_mesh(
    mesh: ColoredMesh, layers: Sequence[Layer], cameras: Sequence[PosedCamera]
) -> dict[str, str]:
    """Return the JSON header and the body that ``mesh_viewer.js`` reads.

    The body is base64 of gzip of, one after the other, (T, 3) int32 differences of vertex indices,
    (V, 3) uint16 positions in the bounding box, and each layer's (V, 3) uint8 colours.
    """
    low_m = mesh.vertices_m.min(axis=0)
    size_m = np.maximum(mesh.vertices_m.max(axis=0) - low_m, 1e-6)
    steps = np.rint((mesh.vertices_m - low_m) / size_m * STEPS).astype("<u2")
    # Differences compress better than indices.
    numbers = np.diff(mesh.triangles.reshape(-1), prepend=0).astype("<i4")
    parts = [numbers.tobytes(), steps.tobytes()]
    parts += [np.ascontiguousarray(layer.colors_rgb).tobytes() for layer in layers]
    header: dict[str, Any] = {
        "vertices": len(mesh.vertices_m),
        "triangles": len(mesh.triangles),
        "low": low_m.tolist(),
        "size": size_m.tolist(),
        "layers": [{"title": x.title, "note": x.note, "shaded": x.shaded} for x in layers],
        "cameras": _frusta(cameras, FRUSTUM_SHARE * float(np.linalg.norm(size_m))),
    }
    body = gzip.compress(b"".join(parts), compresslevel=9, mtime=0)
    # The text must not contain the end tag of its script element.
    text = json.dumps(header).replace("<", "\\u003c")
    return {"header": text, "body": base64.b64encode(body).decode("ascii")}


def _frusta(cameras: Sequence[PosedCamera], depth_m: float) -> list[list[list[float]]]:
    """Return the centre and the four image corners of each camera in ``map``."""
    frusta = []
    for camera in cameras:
        width_px, height_px = camera.intrinsics.width_px - 1, camera.intrinsics.height_px - 1
        pixels = [(0, 0), (width_px, 0), (width_px, height_px), (0, height_px)]
        points_m = np.vstack((np.zeros(3), unproject(pixels, [depth_m] * 4, camera.intrinsics)))
        frusta.append(transform_points(camera.T_map_camera, points_m).round(3).tolist())
    return frusta
