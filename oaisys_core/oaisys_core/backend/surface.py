"""Everything a camera can hit, and what it sees of it: depth and labels, shared by all backends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.solids import Solid, flat_ground, solid_of, tessellated
from oaisys_core.geometry import pixel_rays
from oaisys_core.raycast import NO_TRIANGLE, RayCaster
from oaisys_core.scene import PlacedCamera, Scene, Sky, id_of_level, merge_meshes
from oaisys_core.types import (
    DEPTH,
    INSTANCE,
    RGB,
    FloatArray,
    Frame,
    TriangleMesh,
    semantic_level,
)

NO_SOLID = -1
"""Solid id of a pixel that sees none."""


@dataclass(frozen=True)
class View:
    """What each pixel of a camera sees at its centre; all arrays are (H, W) or (H, W, 3).

    Attributes:
        depth_m: float64 planar z, ``+inf`` where nothing was hit.
        directions: float64 rays in ``map``, of planar length 1.
        points_m: float64 in ``map``; not finite where nothing was hit.
        triangle_ids: int64, `NO_TRIANGLE` where a solid or nothing was hit.
        solid_ids: int64, `NO_SOLID` where a triangle or nothing was hit.
        instance_ids: uint32, 0 for ground and sky.
    """

    depth_m: FloatArray
    directions: FloatArray
    points_m: FloatArray
    triangle_ids: NDArray[np.int64]
    solid_ids: NDArray[np.int64]
    instance_ids: NDArray[np.uint32]

    @cached_property
    def is_hit(self) -> NDArray[np.bool_]:
        """(H, W) whether the pixel sees anything."""
        return np.isfinite(self.depth_m)

    @cached_property
    def is_ground(self) -> NDArray[np.bool_]:
        """(H, W) whether the pixel sees the ground."""
        return np.asarray(self.is_hit & (self.instance_ids == 0))


class Surface:
    """The ground, the objects and the exact solids of a scene."""

    def __init__(
        self, scene: Scene, ground: TriangleMesh | None, objects: Sequence[TriangleMesh]
    ) -> None:
        """Take over a scene with its triangles.

        Args:
            scene: Gives the labels, the solids and the height field.
            ground: Its triangles; None takes the closed form of an exactly flat ground.
            objects: Everything that was placed, with semantic and instance ids.
        """
        self._scene = scene
        self._ground = ground
        self._objects = tuple(objects)
        self._caster = RayCaster([*([ground] if ground else []), *objects])
        self._solids: list[Solid] = [solid_of(primitive) for primitive in scene.primitives]
        self._solid_instance = np.array([p.instance_id for p in scene.primitives], np.uint32)
        flat = flat_ground(scene.ground) if ground is None else None
        if flat is not None:
            self._solids.append(flat)
            self._solid_instance = np.append(self._solid_instance, np.uint32(0))

    def view(self, camera: PlacedCamera) -> View:
        """Return what a camera sees."""
        origin_m = camera.T_map_camera[:3, 3]
        directions = pixel_rays(camera.intrinsics) @ camera.T_map_camera[:3, :3].T
        depth_m, triangle_ids, solid_ids = self._nearest(origin_m, directions)
        instance_ids = self._caster.instance_ids_of(triangle_ids)
        on_solid = solid_ids != NO_SOLID
        instance_ids[on_solid] = self._solid_instance[solid_ids[on_solid]]
        with np.errstate(invalid="ignore"):
            points_m = origin_m + depth_m[..., None] * directions
        return View(depth_m, directions, points_m, triangle_ids, solid_ids, instance_ids)

    def semantic_ids(self, view: View, sky: Sky, level: int = 0) -> NDArray[np.uint16]:
        """Return the (H, W) labels of a view: on the ground those of the heaviest layers."""
        ids = self._semantic_of_instance(level)[view.instance_ids]
        ids[view.is_ground] = self._scene.material.semantic_ids_at(
            view.points_m[view.is_ground][:, :2], level
        )
        ids[~view.is_hit] = sky.semantic_ids_at(view.directions[~view.is_hit], level)
        return ids

    def _semantic_of_instance(self, level: int) -> NDArray[np.uint16]:
        """Return label by instance id; ids are small, as they count objects."""
        labels = {p.instance_id: id_of_level(p.semantic_ids, level) for p in self._scene.primitives}
        placements = self._scene.placements
        most = max([0, *labels, *(int(p.instance_ids.max(initial=0)) for p in placements)])
        result = np.zeros(most + 1, np.uint16)
        for placement in placements:
            result[placement.instance_ids] = id_of_level(placement.semantic_ids, level)
        for instance_id, label in labels.items():
            result[instance_id] = label
        return result

    def normals(self, view: View) -> FloatArray:
        """Return the (H, W, 3) unit normals, turned towards the camera; 0 where nothing was hit."""
        normals = np.zeros_like(view.points_m)
        on_triangle = view.triangle_ids != NO_TRIANGLE
        if on_triangle.any():
            normals[on_triangle] = self._caster.normals_of(view.triangle_ids[on_triangle])
        for index, solid in enumerate(self._solids):
            seen = view.solid_ids == index
            if seen.any():
                normals[seen] = solid.normals_at(view.points_m[seen])
        away = (normals * view.directions).sum(axis=-1) > 0
        normals[away] *= -1
        return normals

    def height_m(self, xy_m: FloatArray) -> FloatArray:
        """Return the (N,) topmost heights at (N, 2) points, NaN off the ground and objects."""
        ground_m = self._scene.ground.height_at(xy_m)
        height_m = np.fmax(ground_m, self._caster.surface_height_m(xy_m))
        above_m = 1.0 + max(
            [float(self._scene.ground.vertices_m()[:, 2].max())]
            + [p.T_map_object[2, 3] + np.linalg.norm(p.size_m) for p in self._scene.primitives]
        )
        origins = np.column_stack((xy_m, np.full(len(xy_m), above_m)))
        down = np.broadcast_to((0.0, 0.0, -1.0), origins.shape)
        for solid in self._solids:
            below_m = above_m - solid.intersect(origins, down)
            height_m = np.where(np.isfinite(below_m), np.fmax(height_m, below_m), height_m)
        return height_m

    def mesh(self) -> TriangleMesh:
        """Return all triangles with ids: solids tessellated, the ground labelled by centroids."""
        ground = self._ground or ground_mesh(self._scene)
        centres_m = ground.vertices_m[ground.triangles, :2].mean(axis=1)
        labelled = replace(
            ground,
            semantic_ids=self._scene.material.semantic_ids_at(centres_m),
            instance_ids=np.zeros(len(ground.triangles), dtype=np.uint32),
        )
        solids = [
            placed(tessellated(p), p.T_map_object[None], p.semantic_ids, np.array([p.instance_id]))
            for p in self._scene.primitives
        ]
        return merge_meshes([labelled, *self._objects, *solids])

    def _nearest(
        self, origin_m: FloatArray, directions: FloatArray
    ) -> tuple[FloatArray, NDArray[np.int64], NDArray[np.int64]]:
        depth_m, triangle_ids = self._caster.intersect(origin_m, directions)
        solid_ids = np.full(depth_m.shape, NO_SOLID, dtype=np.int64)
        for index, solid in enumerate(self._solids):
            solid_depth_m = solid.intersect(origin_m, directions)
            nearer = solid_depth_m < depth_m
            depth_m = np.where(nearer, solid_depth_m, depth_m)
            solid_ids[nearer] = index
        triangle_ids[solid_ids != NO_SOLID] = NO_TRIANGLE
        return depth_m, triangle_ids, solid_ids


def ground_mesh(scene: Scene) -> TriangleMesh:
    """Return the ground's triangles, without ids."""
    return TriangleMesh(scene.ground.vertices_m().astype(np.float64), scene.ground.triangles())


def placed(
    mesh: TriangleMesh,
    T_map_object: FloatArray,
    semantic_ids: Sequence[int],
    instance_ids: NDArray[Any],
) -> TriangleMesh:
    """Return one mesh of (N,) instances of ``mesh``, each at its own (N, 4, 4) pose."""
    count, vertices = len(T_map_object), len(mesh.vertices_m)
    points = np.einsum("nij,vj->nvi", T_map_object[:, :3, :3], mesh.vertices_m)
    points += T_map_object[:, None, :3, 3]
    first = (np.arange(count, dtype=np.int32) * vertices)[:, None, None]
    triangles = (mesh.triangles + first).reshape(-1, 3)
    return TriangleMesh(
        vertices_m=points.reshape(-1, 3),
        triangles=triangles,
        semantic_ids=np.full(len(triangles), id_of_level(semantic_ids, 0), dtype=np.uint16),
        instance_ids=np.repeat(instance_ids.astype(np.uint32), len(mesh.triangles)),
    )


def geometry_frames(surface: Surface, camera: PlacedCamera, sky: Sky) -> dict[str, Frame]:
    """Return the frames of depth and labels that a camera asks for, by modality."""
    if set(camera.modalities) <= {RGB}:
        return {}
    return frames_of(surface, surface.view(camera), camera, sky)


def frames_of(surface: Surface, view: View, camera: PlacedCamera, sky: Sky) -> dict[str, Frame]:
    """Return, of one view, the frames of depth and labels that its camera asks for."""
    images: dict[str, NDArray[Any]] = {}
    if DEPTH in camera.modalities:
        images[DEPTH] = view.depth_m.astype(np.float32)
    for modality in camera.modalities:
        level = semantic_level(modality)
        if level is not None:
            images[modality] = surface.semantic_ids(view, sky, level)
    if INSTANCE in camera.modalities:
        images[INSTANCE] = view.instance_ids
    return {name: frame_of(camera, name, image) for name, image in images.items()}


def frame_of(camera: PlacedCamera, modality: str, image: NDArray[Any]) -> Frame:
    """Return an image as the frame of a camera."""
    return Frame(camera.name, modality, image, camera.intrinsics, camera.T_map_camera)
