"""Checks of user meshes: finite coordinates of a sensible size, valid indices, a real surface."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray

MAX_COORDINATE = 1e7
"""Largest coordinate in the file's units: float32 still resolves a metre, and areas are finite."""

FAR_M = 8192.0
"""Distance from the origin beyond which float32 does not resolve a millimetre."""

MAX_STEP_M = 0.001
"""Step of the numbers of a file beyond which a ground would lose its rows."""

TEXT_VERTEX = {".obj": "v", ".stl": "vertex"}
"""First word of a line with a vertex, by file suffix."""

BLOCK = 1_000_000
"""Triangles whose areas are computed at once."""


class Float32Step(NamedTuple):
    """How fine the float32 numbers of a file are, far from the origin.

    Attributes:
        coordinate: The largest one on an axis on which all vertices lie on one side of the origin,
            in the file's units; 0: there is none, or the file has digits or float64.
        step: To the next float32, in the units in which the file has the mesh.
    """

    coordinate: float = 0.0
    step: float = 0.0


NOT_COARSE = Float32Step()
"""Of digits, integers and float64."""


def are_used(vertices: NDArray[Any], triangles: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which of (V, 3) vertices are corners of (T, 3) triangles.

    >>> are_used(np.zeros((4, 3)), np.array([[0, 1, 3]])).tolist()
    [True, True, False, True]
    """
    used = np.zeros(len(vertices), np.bool_)
    used[triangles] = True
    return used


def float32_step(
    vertices: NDArray[Any], triangles: NDArray[Any], scale: float = 1.0
) -> Float32Step:
    """Return the step of (V, 3) vertices that a file stores as float32.

    Args:
        vertices: As stored.
        triangles: (T, 3) vertex indices; vertices that none has do not count.
        scale: By which the file itself enlarges them.

    >>> corners = np.array([[500000.0, 0.0, 0.0], [500002.0, 1.0, 0.0], [500001.0, 2.0, 0.0]])
    >>> float32_step(corners, np.array([[0, 1, 2]]))
    Float32Step(coordinate=500002.0, step=0.03125)
    """
    if not len(triangles):
        return NOT_COARSE
    found = vertices[are_used(vertices, triangles)]
    low, high = (np.asarray(edge, np.float64) for edge in (found.min(0), found.max(0)))
    farthest = np.maximum(np.abs(low), np.abs(high))
    coordinate = float(np.where(low * high > 0, farthest, 0.0).max())
    return Float32Step(coordinate, float(np.spacing(np.float32(coordinate))) * scale)


def check_float32_step(float32: Float32Step, most: float, path: Path, field: str) -> None:
    """Raise if a file's numbers are coarser than ``most`` of its units, far from the origin.

    Raises:
        InvalidInputError: With the coordinate, the step, and how to store the mesh.
    """
    if float32.step <= most:
        return
    expected = (
        f"coordinates that resolve {most:.3g} of its units, but as float32 they have a"
        f" step of {float32.step:.3g} at {float32.coordinate:.10g}: save them with float64"
        " or as text (.ply of double, .obj), or less a local origin that you add as position_m"
    )
    raise InvalidInputError(field, str(path), expected)


def check_mesh(
    vertices: NDArray[Any], triangles: NDArray[np.int32], path: Path, field: str
) -> None:
    """Raise if a mesh cannot be rendered.

    Args:
        vertices: (V, 3) vertices of the file.
        triangles: (T, 3) vertex indices.
        path: The file; for text files, the error names the line of the first invalid vertex.
        field: Name of the file's field in errors.

    Raises:
        InvalidInputError: A vertex is not finite or too far from the origin, a triangle has an
            index without a vertex, or no triangle has an area.
    """
    with np.errstate(invalid="ignore"):
        bad = ~(np.abs(vertices) <= MAX_COORDINATE).all(axis=1)
    if bad.any():
        index = int(np.argmax(bad))
        line = line_of_bad_vertex(path)
        where = f"vertex {index}" if line is None else f"line {line}"
        numbers = ", ".join(f"{value:.12g}" for value in vertices[index])
        expected = f"finite coordinates of at most {MAX_COORDINATE:g}, not ({numbers}) in {where}"
        raise InvalidInputError(field, str(path), expected)
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise InvalidInputError(
            field, str(path), f"triangle indices below {len(vertices)}, its number of vertices"
        )
    if not _has_area(vertices, triangles):
        raise InvalidInputError(field, str(path), "at least one triangle with an area")


def local_origin(vertices: NDArray[Any], far: float = FAR_M) -> FloatArray:
    """Return whole numbers to subtract from (V, 3) vertices before they become float32.

    0 on the axes on which the vertices lie around the origin, or within ``far`` of it.

    >>> local_origin(np.array([[500000.5, 0.0, 40.0], [500002.0, 9000.0, 41.0]]))
    array([500001.,      0.,      0.])
    """
    low, high = (np.asarray(edge, np.float64) for edge in (vertices.min(0), vertices.max(0)))
    is_far = (np.maximum(np.abs(low), np.abs(high)) > far) & (low * high > 0)
    return np.where(is_far, np.round((low + high) / 2), 0.0)


def check_uv(uvs: Iterable[NDArray[np.float32] | None], path: Path, field: str) -> None:
    """Raise if a mesh's (T, 3, 2) texture coordinates cannot be looked up in its image.

    Args:
        uvs: Of each mesh of the file; None for one without an image.
        path: The file.
        field: Name of the file's field in errors.

    Raises:
        InvalidInputError: A coordinate is not finite or too large.
    """
    for uv in uvs:
        if uv is None:
            continue
        bad = ~(np.abs(uv) <= MAX_COORDINATE).all(axis=-1)
        if bad.any():
            u, v = uv[bad][0]
            expected = (
                f"finite texture coordinates of at most {MAX_COORDINATE:g}, not ({u:g}, {v:g})"
            )
            raise InvalidInputError(field, str(path), expected)


def line_of_bad_vertex(path: Path) -> int | None:
    """Return the line, from 1, of the first vertex of a text file that `check_mesh` refuses."""
    suffix = path.suffix.lower()
    if suffix not in (*TEXT_VERTEX, ".ply"):
        return None
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return None
    if suffix in TEXT_VERTEX:
        word = TEXT_VERTEX[suffix]
        places = [(n, line.split()[1:4]) for n, line in enumerate(lines, 1) if _begins(line, word)]
    elif suffix == ".ply" and "end_header" in lines and "format ascii 1.0" in lines:
        places = [
            (n, line.split()[:3])
            for n, line in enumerate(lines, 1)
            if n > lines.index("end_header") + 1
        ]
    else:
        return None
    return next((number for number, numbers in places if _is_bad(numbers)), None)


def _begins(line: str, word: str) -> bool:
    return line.split(maxsplit=1)[:1] == [word]


def _is_bad(numbers: list[str]) -> bool:
    try:
        values = [float(number) for number in numbers]
    except ValueError:
        return False
    return not all(abs(value) <= MAX_COORDINATE for value in values)


def _has_area(vertices: NDArray[Any], triangles: NDArray[np.int32]) -> bool:
    for first in range(0, len(triangles), BLOCK):
        corners = triangles[first : first + BLOCK].T
        a, b, c = (vertices[corner].astype(np.float64) for corner in corners)
        longest = np.maximum(np.abs(b - a).max(axis=1), np.abs(c - a).max(axis=1))
        # Degenerate within the precision of float32, at any scale.
        flat = np.linalg.norm(np.cross(b - a, c - a), axis=1) <= 1e-12 * longest**2
        if not flat.all():
            return True
    return False
