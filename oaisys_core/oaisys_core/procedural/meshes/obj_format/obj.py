"""Meshes of .obj files: a part for each object and material, with polygons as triangles."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, quote
from oaisys_core.files.documents import read_bytes
from oaisys_core.files.mesh_formats.mesh_headers import MAX_TEXT_BYTES, MAX_VERTICES
from oaisys_core.procedural.meshes.loaded import LoadedMesh
from oaisys_core.procedural.meshes.obj_format.obj_materials import ObjMaterials
from oaisys_core.procedural.meshes.obj_format.obj_statements import FaceGroup, ObjStatements
from oaisys_core.procedural.meshes.polygons import PolygonError, triangulate
from oaisys_core.procedural.meshes.references import FileReferences

LOG = logging.getLogger(__name__)


def load_obj(path: Path, object_name: str | None, field: str) -> list[LoadedMesh] | list[str]:
    """Return the parts of a file, or of one object in it, whose size has been checked.

    Args:
        path: The file.
        object_name: Name of the object, or of a material; None for all objects.
        field: Name of the file's field in errors.

    Returns:
        The parts; or the names of all objects, if none has that name.

    Raises:
        InvalidInputError: It cannot be read, or refers to a file elsewhere.
    """
    try:
        statements = ObjStatements(read_bytes(path, MAX_TEXT_BYTES))
        references = FileReferences(path, field)
        found = list(_Parts(statements, path, references))
    except (OSError, ValueError) as error:
        raise InvalidInputError(field, str(path), f"a .obj file of {error}") from error
    references.tell_missing()
    if statements.unknown:
        names = ", ".join(quote(name) for name in statements.unknown)
        LOG.warning("%s: lines that begin with %s are not read", path, names)
    if object_name is None:
        return [part for _, part in found]
    chosen = [part for names, part in found if object_name in names]
    return chosen or sorted({names[0] for names, _ in found})


class _Parts:
    """The parts of a file, each with the names by which it can be chosen."""

    def __init__(self, statements: ObjStatements, path: Path, references: FileReferences) -> None:
        self._statements, self._stem = statements, path.stem
        self._v, self._vt, self._vn = statements.corners()
        self._materials = ObjMaterials(
            path, references, list(statements.libraries), list(statements.materials)
        )

    def __iter__(self) -> Iterator[tuple[tuple[str, ...], LoadedMesh]]:
        triangles, face_of = self._triangles()
        group_of = self._statements.group_of[face_of]
        order = np.argsort(group_of, kind="stable")
        ends = np.searchsorted(group_of[order], np.arange(len(self._statements.groups)), "right")
        for group, own in zip(self._statements.groups, np.split(order, ends), strict=False):
            name = group.object or group.material or self._stem
            names = (name, f"{name}_{group.material}", group.material or self._stem)
            yield names, self._part(name, group, triangles[own])

    def _triangles(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        statements = self._statements
        count = int((statements.counts - 2).sum())
        if count > MAX_VERTICES:
            raise ValueError(f"at most {MAX_VERTICES} triangles, not {count}")
        try:
            return triangulate(statements.vertices, self._v, statements.counts)
        except PolygonError as error:
            raise ValueError(f"{error}: line {statements.lines[error.index]}") from error

    def _part(self, name: str, group: FaceGroup, corners: NDArray[np.int64]) -> LoadedMesh:
        """Return the mesh of (T, 3) places in the file's list of corners."""
        v = self._v[corners].ravel()
        keys = v
        # Corners of one position with other texture coordinates or normals are seams.
        for more in (self._vt[corners].ravel(), self._vn[corners].ravel()):
            if (more >= 0).any():
                keys = np.unique(keys, return_inverse=True)[1] * (more.max() + 2) + more + 1
        _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
        vertices = self._statements.vertices[v[first]]
        triangles = inverse.reshape(-1, 3).astype(np.int32)
        material = self._materials.of(group.material)
        if material is None:
            colors = self._statements.colors(v[first])
            return LoadedMesh(name, vertices, triangles, vertex_colors_srgb=colors)
        if not group.has_uv:
            return LoadedMesh(name, vertices, triangles, materials=(material.plain,))
        uv = self._statements.uv[self._vt[corners]] * material.scale + material.offset
        return LoadedMesh(
            name, vertices, triangles, uv.astype(np.float32), materials=(material.material,)
        )
