"""A mesh as a page takes it in: thinned out, with layers of colours, packed for JavaScript."""

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

from oaisys_core.geometry import unproject
from oaisys_core.types import FloatArray
from oaisys_mapping.evaluation.evaluate import Evaluation
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.mesh import ColoredMesh, triangle_areas_m2
from oaisys_mapping.report import pictures

MOST_TRIANGLES = 400_000
"""What a page holds: some 4 MB, and what a browser without a GPU still turns."""

COARSER = 1.15
"""Where a mesh is still too large, its next cells are larger by this factor."""

FRUSTUM_SHARE = 0.02
"""Depth of a drawn camera, as a share of the mesh's diagonal."""

STEPS = 65535
"""Positions are counted in steps of this share of the mesh's size."""


IMAGE_SHADING = 0.3
"""How much light is drawn on top of what images already hold."""


@dataclass(frozen=True)
class Layer:
    """One way to colour a mesh.

    Attributes:
        title: On its button.
        note: What its colours mean.
        colors_rgb: (V, 3) uint8, one per vertex.
        shaded: How much of the light is drawn, 0 to 1: pictures have their own.
    """

    title: str
    note: str
    colors_rgb: NDArray[np.uint8]
    shaded: float = 1.0


def layers_of(mesh: ColoredMesh, evaluation: Evaluation, labels: Mapping[int, str]) -> list[Layer]:
    """Return the layers that a mesh has colours for."""
    note = "Colours from the images."
    layers = [Layer("colour", note, mesh.colors_rgb, IMAGE_SHADING), _errors(mesh, evaluation)]
    if mesh.class_ids is not None:
        ids = mesh.class_ids[None]
        note = "The class that the most views gave a place; its colour is that of the label images."
        layers.append(Layer("classes", note, pictures.semantic_picture(ids, labels)[0]))
    return layers


def _errors(mesh: ColoredMesh, evaluation: Evaluation) -> Layer:
    """Colour each vertex by the distance to the truth that was measured nearest to it."""
    limit_m = evaluation.metrics.voxel_size_m / 2
    place = nearest(evaluation.reconstruction.points_m, mesh.vertices_m)
    share = np.minimum(evaluation.reconstruction_distance_m[place] / limit_m, 1.0)
    colors_rgb = (mpl.colormaps["magma_r"](share)[:, :3] * 255).astype(np.uint8)
    far = f"half a voxel, {100 * limit_m:.3g} cm, and above (black)"
    note = f"Distance to the true surface, from 0 (pale) to {far}."
    return Layer("error", note, colors_rgb, 0.6)


def thinned(mesh: ColoredMesh, most_triangles: int = MOST_TRIANGLES) -> ColoredMesh:
    """Return a mesh of at most so many triangles: vertices in a cell become their average.

    Rossignac and Borrel, "Multi-resolution 3D approximations for rendering complex scenes",
    Modeling in Computer Graphics, 1993. A vertex takes its class from the nearest one before.
    """
    if len(mesh.triangles) <= most_triangles:
        return mesh
    whole = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices_m), o3d.utility.Vector3iVector(mesh.triangles)
    )
    whole.vertex_colors = o3d.utility.Vector3dVector(mesh.colors_rgb / 255.0)
    area_m2 = float(triangle_areas_m2(mesh.vertices_m, mesh.triangles).sum())
    # A square of a grid is two triangles.
    cell_m = np.sqrt(2 * area_m2 / most_triangles)
    fewer = whole.simplify_vertex_clustering(cell_m)
    while len(fewer.triangles) > most_triangles:
        cell_m *= COARSER
        fewer = whole.simplify_vertex_clustering(cell_m)
    vertices_m = np.asarray(fewer.vertices)
    colors_rgb = np.rint(np.asarray(fewer.vertex_colors) * 255).astype(np.uint8)
    class_ids = None
    if mesh.class_ids is not None:
        class_ids = mesh.class_ids[nearest(mesh.vertices_m, vertices_m)]
    return ColoredMesh(
        vertices_m, np.asarray(fewer.triangles).astype(np.int32), colors_rgb, class_ids
    )


def nearest(points_m: FloatArray, wanted_m: FloatArray) -> NDArray[np.intp]:
    """Return the (M,) indices of those of (N, 3) points that are nearest to (M, 3) others."""
    return np.asarray(cKDTree(points_m).query(wanted_m)[1])


def packed(
    mesh: ColoredMesh, layers: Sequence[Layer], cameras: Sequence[PosedCamera]
) -> dict[str, str]:
    """Return the JSON header and the body, as ``mesh_viewer.js`` reads them.

    The body is gzip in base64 of, one after the other, (T, 3) int32 differences of vertex numbers,
    (V, 3) uint16 positions in the box, and each layer's (V, 3) uint8 colours.
    """
    low_m = mesh.vertices_m.min(axis=0)
    size_m = np.maximum(mesh.vertices_m.max(axis=0) - low_m, 1e-6)
    steps = np.rint((mesh.vertices_m - low_m) / size_m * STEPS).astype("<u2")
    # Small differences press better than large numbers.
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
    # Inside a script element nothing may look like its end.
    text = json.dumps(header).replace("<", "\\u003c")
    return {"header": text, "body": base64.b64encode(body).decode("ascii")}


def _frusta(cameras: Sequence[PosedCamera], depth_m: float) -> list[list[list[float]]]:
    """Return for each camera its centre and the four corners of its image, in ``map``."""
    frusta = []
    for camera in cameras:
        width_px, height_px = camera.intrinsics.width_px - 1, camera.intrinsics.height_px - 1
        pixels = [(0, 0), (width_px, 0), (width_px, height_px), (0, height_px)]
        points_m = np.vstack((np.zeros(3), unproject(pixels, [depth_m] * 4, camera.intrinsics)))
        in_map = points_m @ camera.T_map_camera[:3, :3].T + camera.T_map_camera[:3, 3]
        frusta.append(in_map.round(3).tolist())
    return frusta
