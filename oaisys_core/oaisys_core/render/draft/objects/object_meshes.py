"""The meshes of all objects as one, to look up many points on any of them at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.render.draft.appearance import (
    Floats,
    by_component,
    cross,
    dot,
    empty,
    normalise,
    places_m,
    take,
    zeros,
)
from oaisys_core.scene import MeshPrototype, Scene
from oaisys_core.types import FloatArray

LINEAR = linear(np.arange(256) / 255).astype(np.float32)
"""Linear values of bytes in sRGB."""

WHITE = np.ones(3, np.float32)


class MeshPoints(NamedTuple):
    """N points on meshes.

    Attributes:
        normal: (N, 3) interpolated between the corners, in the objects' frames, of any length.
        face: (N, 3) normals of the triangles, likewise.
        color: (N, 3) linear colours of the vertices; white without any.
        through: (N,) see `Appearance`; of water, the opacity.
    """

    normal: Floats
    face: Floats
    color: Floats
    through: Floats


class ObjectMeshes:
    """The meshes of a scene's prototypes, one after the other."""

    def __init__(self, prototypes: Sequence[MeshPrototype]) -> None:
        """Copy the meshes."""
        none = np.zeros((0, 3), np.float32)
        vertices = [each.vertices_m for each in prototypes]
        starts = np.cumsum([0, *map(len, vertices)])
        self.first_triangle = np.cumsum([0, *(len(each.triangles) for each in prototypes)])
        self._vertices = by_component(np.concatenate([none, *vertices]))
        triangles = [
            each.triangles + start for each, start in zip(prototypes, starts[:-1], strict=True)
        ]
        corners = np.concatenate([none.astype(np.int64), *triangles])
        self._triangles = np.asarray(corners, np.intp, order="F")
        normals = [vertex_normals(each.vertices_m, each.triangles) for each in prototypes]
        self._normals = by_component(np.concatenate([none, *normals]))
        self._colors = by_component(np.concatenate([none, *map(_colors, prototypes)]))
        self._through = np.concatenate([none[:, 0], *map(_through, prototypes)])
        self._has_colors = bool((self._colors != 1).any())
        self._has_through = bool(self._through.any())

    def at(self, triangles: NDArray[np.int64], points: Floats) -> MeshPoints:
        """Return what (N,) triangles of all meshes have at (N, 3) points in their own frames."""
        corners = take(self._triangles, triangles).T
        a, b, c = (take(self._vertices, corner) for corner in corners)
        b -= a
        c -= a
        face = cross(b, c)
        shares = _shares(b, c, points - a, face)
        normal = _interpolate(self._normals, corners, shares)
        count = len(triangles)
        color, through = zeros(count, 3) + WHITE, np.zeros(count, np.float32)
        if self._has_colors:
            color = _interpolate(self._colors, corners, shares)
        if self._has_through:
            through = _interpolate(self._through, corners, shares)
        return MeshPoints(normal, face, color, through)


def vertex_normals(vertices_m: NDArray[Any], triangles: NDArray[np.int32]) -> Floats:
    """Return (V, 3) unit normals: means of the triangles around, by their angles there."""
    corners = [vertices_m[corner].astype(np.float32) for corner in triangles.T]
    face = normalise(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    total = np.zeros((3, len(vertices_m)))
    for index in range(3):
        ahead = normalise(corners[(index + 1) % 3] - corners[index])
        back = normalise(corners[(index + 2) % 3] - corners[index])
        angle = np.arccos(np.clip(np.einsum("ij,ij->i", ahead, back), -1, 1))
        for axis in range(3):
            total[axis] += np.bincount(
                triangles[:, index], angle * face[:, axis], minlength=len(vertices_m)
            )
    return normalise(total.T.astype(np.float32))


def interpolate_normals(
    vertices_m: NDArray[Any],
    triangles: NDArray[np.int32],
    normals: Floats,
    elements: NDArray[np.int64],
    points_m: FloatArray,
) -> Floats:
    """Return (N, 3) unit normals at (N, 3) points on (N,) triangles of a mesh.

    ``normals`` are the (V, 3) of its vertices.
    """
    corners = triangles.take(elements, axis=0).T
    a, b, c = (places_m(vertices_m.take(corner, axis=0)) for corner in corners)
    edge, other, offset = (by_component(each - a) for each in (b, c, points_m))
    shares = _shares(edge, other, offset, cross(edge, other))
    return normalise(_interpolate(normals, corners, shares))


def _interpolate(
    values: Floats, corners: NDArray[np.integer[Any]], shares: tuple[Floats, ...]
) -> Floats:
    """Return (N, C) or (N,) means of what the (3, N) corners of triangles have."""
    found = [take(values, corner) for corner in corners]
    for of_corner, share in zip(found, shares, strict=True):
        of_corner[:] *= share if values.ndim == 1 else share[:, None]
    found[0] += found[1]
    found[0] += found[2]
    return found[0]


def _shares(b: Floats, c: Floats, offset: Floats, face: Floats) -> tuple[Floats, Floats, Floats]:
    """Return (N,) barycentric coordinates, from two edges and the offset from a corner."""
    area = np.maximum(dot(face, face), np.float32(1e-30))
    second = np.clip(dot(cross(offset, c), face) / area, 0, 1)
    third = np.clip(dot(cross(b, offset), face) / area, 0, 1)
    return 1 - second - third, second, third


def _colors(prototype: MeshPrototype) -> Floats:
    colors = prototype.vertex_colors_srgb
    if colors is None or prototype.maps is not None:
        return np.broadcast_to(WHITE, (len(prototype.vertices_m), 3))
    return np.asarray(LINEAR[colors])


def _through(prototype: MeshPrototype) -> Floats:
    shares = prototype.translucency if prototype.water is None else prototype.water.opacity
    if shares is None:
        return np.zeros(len(prototype.vertices_m), np.float32)
    return shares.astype(np.float32) * np.float32(1 / 255)


class Instances:
    """Finds prototype and pose of instances by their ids; all arrays are in the ids' order.

    Attributes:
        order: (I,) places of the ids in the order of the scene's placements.
        prototypes: (I,) indices.
        positions_m: (I, 3) in ``map``.
        scale: (I,) sizes.
        rotations: (I, 3, 3) from the objects' axes to those of ``map``, one component of all after
            the other.
    """

    def __init__(self, scene: Scene) -> None:
        """Take over the placements of a scene."""
        no_ids = np.zeros(0, np.uint32)
        ids = np.concatenate([no_ids, *(each.instance_ids for each in scene.placements)])
        counts = [len(each.instance_ids) for each in scene.placements]
        self.order = order = np.argsort(ids, kind="stable")
        self._ids: NDArray[np.uint32] = ids[order]
        prototypes = np.repeat([p.prototype for p in scene.placements], counts)
        self.prototypes = prototypes[order].astype(np.intp)
        poses = [np.zeros((0, 4, 4)), *(each.T_map_object for each in scene.placements)]
        T = np.concatenate(poses)[order]
        scale = np.linalg.norm(T[:, :3, 0], axis=1)
        self.positions_m = places_m(T[:, :3, 3])
        self.scale = scale.astype(np.float32)
        self.rotations = by_component(T[:, :3, :3] / scale[:, None, None])

    @property
    def ids(self) -> NDArray[np.uint32]:
        """(I,) ids in ascending order, which all other arrays are in."""
        return self._ids

    def find(self, instance_ids: NDArray[np.uint32]) -> NDArray[np.intp]:
        """Return the (N,) places of ids in the arrays of this object; -1 where there is none."""
        if not len(self._ids):
            return np.full(len(instance_ids), -1)
        place = np.minimum(np.searchsorted(self._ids, instance_ids), len(self._ids) - 1)
        return np.where(self._ids[place] == instance_ids, place, -1)


def to_map(R: Floats, vectors: Floats) -> Floats:
    """Return (N, 3) vectors in the axes of ``map`` of those in objects' axes.

    ``R`` are the (N, 3, 3) `Instances.rotations` of each.
    """
    found = empty(*vectors.shape)
    for row in range(3):
        found[:, row] = dot(R[:, row], vectors)
    return found


def to_objects(R: Floats, vectors: Floats) -> Floats:
    """Return the inverse of `to_map`."""
    found = empty(*vectors.shape)
    for column in range(3):
        found[:, column] = dot(R[:, :, column], vectors)
    return found
