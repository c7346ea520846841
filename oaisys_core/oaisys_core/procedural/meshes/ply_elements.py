"""What the elements of a .ply file say: polygons, and colours of any type of number."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.meshes.polygons import PolygonError, triangulate
from oaisys_core.types import FloatArray

COLORS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
"""Names of a colour's properties."""

CORNERS = ("vertex_indices", "vertex_index")
"""Names of the list of a face's corners."""


class PlyMesh(NamedTuple):
    """The surface of a file.

    Attributes:
        vertices: (V, 3).
        triangles: (T, 3) int32.
        face_of: (T,) face of each triangle.
        concave: The first face, from 0, whose triangles are no fan; None: none.
    """

    vertices: FloatArray
    triangles: NDArray[np.int32]
    face_of: NDArray[np.int64]
    concave: int | None


def ply_mesh(elements: Mapping[str, Any]) -> PlyMesh:
    """Return the surface in the elements that trimesh has read.

    Raises:
        ValueError: A face has no triangles, or an index without a vertex.
    """
    if elements.get("tristrips", {}).get("length"):
        raise ValueError("faces in place of tristrips")
    vertices = np.column_stack([_column(elements["vertex"], axis) for axis in "xyz"])
    corners, counts = _polygons(elements["face"])
    if len(counts) and counts.min() < 3:
        raise ValueError(f"faces of three or more corners: face {int(np.argmin(counts))} has fewer")
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(vertices):
        raise ValueError(f"triangle indices below {len(vertices)}, its number of vertices")
    try:
        places, face_of = triangulate(vertices, corners, counts)
    except PolygonError as error:
        raise ValueError(f"{error}: face {error.index}") from error
    within = places - (np.cumsum(counts) - counts)[face_of, None]
    clipped = (within[:, 0] != 0) | (within[:, 2] != within[:, 1] + 1)
    concave = int(face_of[np.argmax(clipped)]) if clipped.any() else None
    return PlyMesh(vertices, corners[places].astype(np.int32), face_of, concave)


def ply_colors(elements: Mapping[str, Any], mesh: PlyMesh) -> NDArray[np.uint8] | None:
    """Return the (V, 3) colours of vertices, or the means of those of their faces; None: none.

    Raises:
        ValueError: What the numbers of the colours mean is not clear.
    """
    own = _colors(elements["vertex"], "vertex")
    if own is not None:
        return np.asarray(np.rint(own), np.uint8)
    of_faces = _colors(elements["face"], "face")
    if of_faces is None:
        return None
    corners = mesh.triangles.ravel()
    faces = np.repeat(mesh.face_of, 3)
    number = np.maximum(np.bincount(corners, minlength=len(mesh.vertices)), 1)
    sums = [
        np.bincount(corners, of_faces[faces, channel], len(mesh.vertices)) for channel in range(3)
    ]
    return np.asarray(np.rint(np.stack(sums, axis=1) / number[:, None]), np.uint8)


def _column(element: Mapping[str, Any], name: str) -> FloatArray:
    return np.asarray(element["data"][name], np.float64).reshape(element["length"])


def _polygons(face: Mapping[str, Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the corners of all faces, one after another, and how many each has."""
    lists = [name for name, kind in face["properties"].items() if "(" in kind]
    named = [name for name in CORNERS if name in lists] or (lists if len(lists) == 1 else [])
    if not named:
        raise ValueError(f"faces with a list called {CORNERS[0]}, not {', '.join(lists) or 'none'}")
    data = face["data"]
    if isinstance(data, np.ndarray):
        for name in lists:
            # trimesh takes all lists to be as long as the first one.
            if (data[name]["f0"] != data[name]["f0"][0]).any():
                raise ValueError("faces with equally many corners, which binary files need here")
        found = data[named[0]]["f1"].reshape(len(data), -1)
    else:
        found = data[named[0]]
    if found.dtype != object:
        return found.ravel().astype(np.int64), np.full(len(found), found.shape[1], np.int64)
    counts = np.array([len(each) for each in found], np.int64)
    return np.concatenate(list(found)).astype(np.int64), counts


def _colors(element: Mapping[str, Any], where: str) -> FloatArray | None:
    """Return colours (N, 3) from 0 to 255, whatever type of number they have."""
    kinds = element["properties"]
    names = next((names for names in COLORS if all(name in kinds for name in names)), None)
    if names is None:
        return None
    values = np.stack([_column(element, name) for name in names], axis=1)
    kind = np.dtype(kinds[names[0]])
    if kind.kind == "f":
        factor, most = 255.0, 1.0
    elif kind == np.dtype(kind.str[:1] + "u2"):
        factor, most = 1 / 257, 65535.0
    else:
        factor, most = 1.0, 255.0
    least, largest = float(values.min()), float(values.max())
    if not 0 <= least <= largest <= most:
        bad = least if not least >= 0 else largest
        raise ValueError(f"{where} colours of {kind.name} from 0 to {most:g}, not {bad:g}")
    if most > 255 and 0 < largest <= 255:
        expected = f"{where} colours of {kind.name} up to 65535, or of uchar"
        raise ValueError(f"{expected}: these are at most {largest:g}")
    return values * factor
