"""What the elements of a .ply file say: polygons, colours of any type of number, images."""

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


UV = (("texture_u", "texture_v"), ("u", "v"), ("s", "t"))
"""Names of the texture coordinates of a vertex; those of a face are a list, ``texcoord``."""

TEXTURE_NUMBER = "texnumber"
"""Name of the image of a face, or of a vertex, among several."""


class PlyMesh(NamedTuple):
    """The surface of a file.

    Attributes:
        vertices: (V, 3).
        triangles: (T, 3) int32.
        face_of: (T,) face of each triangle.
        places: (T, 3) of their corners among the corners of all faces.
    """

    vertices: FloatArray
    triangles: NDArray[np.int32]
    face_of: NDArray[np.int64]
    places: NDArray[np.int64]


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
    return PlyMesh(vertices, corners[places].astype(np.int32), face_of, places)


def has_float_vertices(elements: Mapping[str, Any]) -> bool:
    """Return whether coordinates are float32, or coarser, rather than float64 or integers."""
    kinds = [_kind_of(elements["vertex"]["properties"], axis) for axis in "xyz"]
    return any(kind.kind == "f" and kind.itemsize < 8 for kind in kinds)


def _kind_of(properties: Mapping[str, str], name: str) -> np.dtype[Any]:
    try:
        return np.dtype(properties[name])
    except ValueError as error:  # trimesh's kind of a list
        raise ValueError(f"vertices with one number as {name}, not a list") from error


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


def ply_uv(elements: Mapping[str, Any], mesh: PlyMesh) -> NDArray[np.float32] | None:
    """Return the (T, 3, 2) texture coordinates of corners, v up; None: there are none.

    Raises:
        ValueError: Some corners have none.
    """
    face, vertex = elements["face"], elements["vertex"]
    if "texcoord" in face["properties"]:
        numbers, lengths = _lists(face, "texcoord")
        _, counts = _polygons(face)
        if (lengths != 2 * counts).any():
            bad = int(np.argmax(lengths != 2 * counts))
            raise ValueError(f"two of texcoord for each corner: face {bad} has {lengths[bad]}")
        return numbers.astype(np.float32).reshape(-1, 2)[mesh.places]
    for names in UV:
        if all(name in vertex["properties"] for name in names):
            uv = np.stack([_column(vertex, name) for name in names], axis=1)
            return uv.astype(np.float32)[mesh.triangles]
    return None


def ply_image_of(elements: Mapping[str, Any], mesh: PlyMesh, count: int) -> NDArray[np.uint16]:
    """Return the (T,) number of the image of each triangle, of so many.

    Raises:
        ValueError: It is not said, or of no image.
    """
    numbers = np.zeros((len(mesh.triangles), 1))
    if TEXTURE_NUMBER in elements["face"]["properties"]:
        numbers = _column(elements["face"], TEXTURE_NUMBER)[mesh.face_of, None]
    elif TEXTURE_NUMBER in elements["vertex"]["properties"]:
        numbers = _column(elements["vertex"], TEXTURE_NUMBER)[mesh.triangles]
    elif count > 1:
        raise ValueError(f"faces with {TEXTURE_NUMBER}, as there are {count} of TextureFile")
    first = numbers[:, :1]
    bad = ((numbers != first) | (first != np.floor(first)) | (first < 0) | (first >= count)).any(1)
    if bad.any():
        row = int(np.argmax(bad))
        shown = ", ".join(f"{number:g}" for number in dict.fromkeys(numbers[row].tolist()))
        expected = f"one {TEXTURE_NUMBER} from 0 to {count - 1}, of its TextureFile, not {shown}"
        raise ValueError(f"{expected}: face {mesh.face_of[row]}")
    return np.asarray(first[:, 0], np.uint16)


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
    corners, counts = _lists(face, named[0])
    return corners.astype(np.int64), counts


def _lists(element: Mapping[str, Any], name: str) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Return the numbers of all lists of a name, one after another, and the length of each."""
    length, data = element["length"], element["data"]
    found = data[name]["f1"] if isinstance(data, np.ndarray) else data[name]
    if found.dtype != object:
        # trimesh takes the axis from a single list.
        found = found.reshape(length, -1)
        return found.ravel(), np.full(length, found.shape[1], np.int64)
    counts = np.array([len(each) for each in found], np.int64)
    return np.concatenate(list(found)), counts


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
