"""One object of a scene by itself: its shape, its pose, and rays cast at it alone."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.instance_boxes import BoxInstanceTarget
from oaisys_core.raycast.prototype_meshes import PlacedPrototype, PrototypeMesh
from oaisys_core.raycast.solids import target_of, tessellate
from oaisys_core.raycast.targets.ray_target import NO_ELEMENT
from oaisys_core.scene import Placement, Primitive, id_of_level
from oaisys_core.types import FloatArray, ShortRepr, TriangleMesh


@dataclass(frozen=True, repr=False)
class Body(ShortRepr):
    """The shape of an object at a scale of 1, in its own frame.

    Attributes:
        sha256: Hash of it.
        low_m, high_m: (3,) corners of its box.
        diameter_m: Largest distance of two points.
    """

    sha256: str
    low_m: FloatArray
    high_m: FloatArray
    diameter_m: float


@dataclass(frozen=True)
class SingleObject:
    """An object of a scene that an image shows.

    ``cast`` casts rays at it, if it is at a pose, from a point in ``map``; ``mesh`` returns its
    triangles at a scale of 1, in its own frame.
    """

    instance_id: int
    semantic_id: int
    body: Body
    T_map_object: FloatArray
    cast: Callable[[FloatArray, FloatArray, FloatArray], NDArray[np.bool_]]
    mesh: Callable[[], TriangleMesh]


def single_instance(
    mesh: PrototypeMesh, body: Body, placement: Placement, row: int
) -> SingleObject:
    """Return one instance of a placement."""

    def cast(T: FloatArray, eye_m: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        if mesh.textures.has_cut_outs:
            one = replace(
                placement,
                T_map_object=T[None],
                instance_ids=placement.instance_ids[row : row + 1],
            )
            _, elements = BoxInstanceTarget([PlacedPrototype(mesh, one)]).intersect(
                eye_m, directions
            )
        else:
            T_object_map = np.linalg.inv(T)
            origin = T_object_map[:3, :3] @ eye_m + T_object_map[:3, 3]
            _, elements = mesh.target.intersect(origin, directions @ T_object_map[:3, :3].T)
        return np.asarray(elements != NO_ELEMENT)

    def triangles() -> TriangleMesh:
        return TriangleMesh(mesh.vertices_m, mesh.prototype.triangles)

    semantic_id = id_of_level(placement.semantic_ids, 0)
    T_map_object = placement.T_map_object[row]
    instance_id = int(placement.instance_ids[row])
    return SingleObject(instance_id, semantic_id, body, T_map_object, cast, triangles)


def single_solid(primitive: Primitive) -> SingleObject:
    """Return an exact solid."""
    is_sphere = primitive.shape == "sphere"
    half_m = np.array([primitive.size_m[0]] * 3 if is_sphere else primitive.size_m, np.float64)
    half_m = half_m if is_sphere else half_m / 2
    diameter_m = 2 * primitive.size_m[0] if is_sphere else 2 * float(np.linalg.norm(half_m))
    sha256 = hashlib.sha256(f"{primitive.shape} {half_m.tolist()}".encode()).hexdigest()

    def cast(T: FloatArray, eye_m: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        target = target_of(replace(primitive, T_map_object=T))
        return np.asarray(target.intersect(eye_m, directions)[1] != NO_ELEMENT)

    body = Body(sha256, -half_m, half_m, diameter_m)
    semantic_id = id_of_level(primitive.semantic_ids, 0)
    T_map_object = primitive.T_map_object
    mesh = partial(tessellate, primitive)
    return SingleObject(primitive.instance_id, semantic_id, body, T_map_object, cast, mesh)


def body_of(mesh: PrototypeMesh) -> Body:
    """Return the shape of a mesh; vertices of no triangle do not count."""
    prototype = mesh.prototype
    digest = hashlib.sha256(np.ascontiguousarray(prototype.vertices_m, "<f4").tobytes())
    digest.update(np.ascontiguousarray(prototype.triangles, "<i4").tobytes())
    points_m = mesh.vertices_m[np.unique(prototype.triangles)]
    low_m, high_m = points_m.min(axis=0), points_m.max(axis=0)
    return Body(digest.hexdigest(), low_m, high_m, _diameter_m(points_m))


def _diameter_m(points_m: FloatArray) -> float:
    """Return the largest distance of two of (N, 3) points."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        points_m = points_m[ConvexHull(points_m).vertices]
    except QhullError:  # all in one plane, or on one line
        points_m = np.unique(points_m, axis=0)
    chunks = np.array_split(points_m, max(1, len(points_m) // 256))
    return float(max(np.linalg.norm(c[:, None] - points_m, axis=2).max() for c in chunks))
