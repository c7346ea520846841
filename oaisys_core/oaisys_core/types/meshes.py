"""Meshes of triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types.arrays import FloatArray, ShortRepr


@dataclass(frozen=True, repr=False)
class TriangleMesh(ShortRepr):
    """Triangles in ``map``, with optional ids per triangle.

    Attributes:
        vertices_m: (V, 3) float64.
        triangles: (T, 3) int32 vertex indices.
        semantic_ids: (T,) uint16 or None.
        instance_ids: (T,) uint32 or None.
    """

    vertices_m: FloatArray
    triangles: NDArray[np.int32]
    semantic_ids: NDArray[np.uint16] | None = None
    instance_ids: NDArray[np.uint32] | None = None


def merge_meshes(meshes: list[TriangleMesh]) -> TriangleMesh:
    """Return several meshes as one; either all or none of them have ids."""
    offsets = np.cumsum([0] + [len(m.vertices_m) for m in meshes[:-1]])
    semantic = [m.semantic_ids for m in meshes if m.semantic_ids is not None]
    instance = [m.instance_ids for m in meshes if m.instance_ids is not None]
    return TriangleMesh(
        vertices_m=np.concatenate([m.vertices_m for m in meshes]),
        triangles=np.concatenate(
            [m.triangles + np.int32(o) for m, o in zip(meshes, offsets, strict=True)]
        ),
        semantic_ids=np.concatenate(semantic) if semantic else None,
        instance_ids=np.concatenate(instance) if instance else None,
    )
