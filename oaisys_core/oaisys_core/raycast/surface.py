"""Depth and labels by ray casting, shared by all backends."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.geometry import pixel_rays
from oaisys_core.raycast.far_ground import FarGroundTarget
from oaisys_core.raycast.prototype_meshes import merge_instances
from oaisys_core.raycast.solids import SolidTarget, flat_ground, target_of, tessellate
from oaisys_core.raycast.targets.ground_target import ground_mesh, ground_target
from oaisys_core.raycast.targets.placement_targets import PlacementTargets
from oaisys_core.raycast.targets.ray_target import RayCone, RayTarget
from oaisys_core.raycast.view import (
    NO_TARGET,
    InstanceTable,
    View,
    bands,
    count_bands,
    empty_vectors,
    take_rows,
)
from oaisys_core.scene import PlacedCamera, Scene, id_of_level
from oaisys_core.types import FloatArray, TriangleMesh, merge_meshes

CORES = len(os.sched_getaffinity(0))
"""Processors that this process may use."""


class Surface:
    """The surface of a scene: ground, objects and exact solids, each rebuilt only when it changes.

    Views and heights include the ground beyond the stage if the scene has any; the mesh does not.
    """

    def __init__(self, scene: Scene, ground: TriangleMesh | None) -> None:
        """Take over a scene and the triangles of its ground.

        Args:
            scene: The scene.
            ground: None: the closed form of an exactly flat ground, or the scene's own triangles.
        """
        self._objects = PlacementTargets(scene)
        self._objects.prepare()
        self._far_ground: FarGroundTarget | None = None
        self._pool: ThreadPoolExecutor | None = None
        self.update(scene, ground)

    @property
    def scene(self) -> Scene:
        """The current scene."""
        return self._scene

    def update(self, scene: Scene, ground: TriangleMesh | None) -> None:
        """Take over a changed scene, with new triangles of its ground (see `__init__`)."""
        flat = flat_ground(scene.ground) if ground is None else None
        self._ground = ground
        self._ground_target: RayTarget
        if flat is not None:
            self._ground_target = SolidTarget(flat, 0, flat.height_m)
        else:
            self._ground, target = ground_target(scene, ground)
            # Else the first view would wait for it.
            target.prepare()
            self._ground_target = target
        self.update_objects(scene)

    def start_batch(self, scene: Scene) -> None:
        """Take over the scene of another batch on the same ground.

        New objects are prepared by the first view.
        """
        self._objects.start_batch(scene)
        self.update_objects(scene)

    def update_objects(self, scene: Scene) -> None:
        """Take over a scene with the same ground; the ground's material may differ."""
        self._scene = scene
        self._objects.update(scene)
        solids = [target_of(primitive) for primitive in scene.primitives]
        self._targets: list[RayTarget] = [self._ground_target, *self._objects.targets, *solids]
        self._set_far_ground(scene)

    def _set_far_ground(self, scene: Scene) -> None:
        """Add the ground beyond the stage, if there is any."""
        if scene.far_ground is None:
            self._far_ground = None
            return
        if self._far_ground is None or self._far_ground.far_ground is not scene.far_ground:
            self._far_ground = FarGroundTarget(scene.far_ground)
        # Last, because few rays have hit nothing until then.
        self._targets.append(self._far_ground)

    def view(self, camera: PlacedCamera) -> View:
        """Cast one ray through each pixel's centre and return the first hits.

        With a rolling shutter, the rays of each row start at the camera's pose at its own time.
        """
        camera_rays = pixel_rays(camera.intrinsics)
        shape = camera_rays.shape[:-1]
        view = View(
            depth_m=np.full(shape, np.inf),
            directions=empty_vectors(*shape),
            points_m=empty_vectors(*shape),
            targets=np.full(shape, NO_TARGET, dtype=np.int64),
            elements=np.zeros(shape, dtype=np.int64),
            instance_ids=np.zeros(shape, dtype=np.uint32),
        )

        T_map_camera, row_poses = camera.T_map_camera, camera.row_poses()
        visible_pixels: list[NDArray[np.bool_] | None] = [None] * len(self._targets)
        if row_poses is None:
            visible_pixels = [target.visible_pixels(camera) for target in self._targets]

        def cast(rows: slice) -> None:
            band = view.rows(rows)
            if row_poses is None:
                R_camera_map, eyes_m = T_map_camera[:3, :3].T, T_map_camera[:3, 3]
                origins_m = eyes_m
            else:
                R_camera_map = row_poses[rows, :3, :3].swapaxes(1, 2)
                eyes_m = row_poses[rows, None, :3, 3]
                origins_m = np.repeat(eyes_m[:, 0], shape[1], axis=0)
            rays = camera_rays[rows] @ R_camera_map
            for axis in range(3):
                band.directions[..., axis] = rays[..., axis]
            for index, pixels in enumerate(visible_pixels):
                of_band = None if pixels is None else pixels[rows]
                self._cast_at(index, origins_m, band, of_band)
            with np.errstate(invalid="ignore"):
                for axis in range(3):
                    along_m = band.depth_m * band.directions[..., axis]
                    np.add(along_m, eyes_m[..., axis], out=band.points_m[..., axis])

        self.each_band((shape[0], shape[1]), cast)
        return view

    @contextmanager
    def in_parallel(self) -> Iterator[None]:
        """Work on bands of images with all cores until the block ends; the images are the same."""
        with ThreadPoolExecutor(CORES, "bands") as pool:
            self._pool = pool
            try:
                yield
            finally:
                self._pool = None

    def each_band(self, shape: tuple[int, int], work: Callable[[slice], None]) -> None:
        """Have work done on the rows of each band of an image."""
        parts = bands(*shape)
        if self._pool is None or count_bands(*shape) == 1:
            for rows in parts:
                work(rows)
        else:
            list(self._pool.map(work, parts))

    def cast(self, origins_m: FloatArray, directions: FloatArray, limit_m: float) -> View:
        """Cast rays that may begin anywhere, and return their first hits as a view of one column.

        Args:
            origins_m: (R, 3) in ``map``, or (3,) for all rays.
            directions: (R, 3) unit vectors in ``map``; the view's depth is then the range.
            limit_m: Ranges beyond which nothing is hit.
        """
        shape = (len(directions), 1)
        view = View(
            depth_m=np.full(shape, np.nextafter(limit_m, np.inf)),
            directions=directions[:, None],
            points_m=np.empty((*shape, 3)),
            targets=np.full(shape, NO_TARGET, dtype=np.int64),
            elements=np.zeros(shape, dtype=np.int64),
            instance_ids=np.zeros(shape, dtype=np.uint32),
        )
        for rows in bands(*shape):
            band = view.rows(rows)
            origins = origins_m if origins_m.ndim == 1 else origins_m[rows]
            for index in range(len(self._targets)):
                self._cast_at(index, origins, band, None)
            band.depth_m[band.targets == NO_TARGET] = np.inf
            with np.errstate(invalid="ignore"):
                np.multiply(band.depth_m[..., None], band.directions, out=band.points_m)
            band.points_m[:, 0] += origins
        return view

    def _cast_at(
        self, index: int, origins_m: FloatArray, view: View, pixels: NDArray[np.bool_] | None
    ) -> None:
        """Cast the rays of some pixels, or of all, at one target, and keep nearer hits.

        ``origins_m`` is (3,), or (R, 3) if ``pixels`` is None.
        """
        if pixels is not None and not pixels.any():
            return
        target = self._targets[index]
        rays: Any = slice(None) if pixels is None else np.flatnonzero(pixels)
        depth_m = view.depth_m.reshape(-1)
        limits = depth_m[rays]
        directions = take_rows(view.directions.reshape(-1, 3), rays)
        found_m, elements = target.intersect(origins_m, directions, limits)
        nearer: Any = np.flatnonzero(found_m < limits)
        if len(nearer) == len(found_m):
            nearer = slice(None)
        elements = elements[nearer]
        seen = nearer if pixels is None else rays[nearer]
        depth_m[seen] = found_m[nearer]
        view.targets.reshape(-1)[seen] = index
        view.elements.reshape(-1)[seen] = elements
        view.instance_ids.reshape(-1)[seen] = target.instance_ids_of(elements)

    def semantic_ids(self, view: View, level: int = 0) -> NDArray[np.uint16]:
        """Return the (H, W) semantic ids of a view: of objects, of the ground's layers, of sky."""
        scene = self._scene
        of_placements = [id_of_level(p.semantic_ids, level) for p in scene.placements]
        of_primitives = [id_of_level(p.semantic_ids, level) for p in scene.primitives]
        of_instance = InstanceTable(scene, of_placements, of_primitives, np.uint16)
        ids = np.empty(view.depth_m.shape, np.uint16)

        def label(rows: slice) -> None:
            ids[rows] = self._labels(view.rows(rows), of_instance, level)

        self.each_band((ids.shape[0], ids.shape[1]), label)
        return ids

    def _labels(self, view: View, of_instance: InstanceTable, level: int) -> NDArray[np.uint16]:
        shape, scene = view.depth_m.shape, self._scene
        ids = np.zeros(view.depth_m.size, np.uint16)
        objects = np.flatnonzero(view.instance_ids)
        ids[objects] = of_instance(view.instance_ids.reshape(-1)[objects])
        ground: Any = np.flatnonzero(view.is_ground)
        if len(ground) == len(ids):
            ground = slice(None)
        xy_m = take_rows(view.points_m.reshape(-1, 3)[:, :2], ground)
        ids[ground] = scene.material.semantic_ids_at(xy_m, level)
        own = scene.sky.ground_semantic_ids
        if self._far_ground is not None and own is not None:
            ids[view.targets.reshape(-1) == len(self._targets) - 1] = id_of_level(own, level)
        missed = np.flatnonzero(~view.is_hit)
        if len(missed):
            rays = np.ascontiguousarray(view.directions.reshape(-1, 3)[missed])
            ids[missed] = scene.sky.semantic_ids_at(rays, level)
        return ids.reshape(shape)

    def normals(self, view: View) -> FloatArray:
        """Return the (H, W, 3) unit normals in ``map``, facing the camera; 0 without a hit."""
        normals = np.zeros(view.points_m.shape)
        for index, target in enumerate(self._targets):
            seen = view.targets == index
            if seen.any():
                normals[seen] = target.normals_of(view.elements[seen], view.points_m[seen])
        away = (normals * view.directions).sum(axis=-1) > 0
        normals[away] *= -1
        return normals

    def triangles_of(self, view: View) -> NDArray[np.int64]:
        """Return the (N,) triangles of a view of one column, in the meshes of their objects."""
        triangles = np.zeros(len(view.depth_m), np.int64)
        for index in np.unique(view.targets).tolist():
            if index != NO_TARGET:
                seen = view.targets[:, 0] == index
                triangles[seen] = self._targets[index].triangles_of(view.elements[seen, 0])
        return triangles

    def are_occluded_along(self, origins_m: FloatArray, direction: FloatArray) -> NDArray[np.bool_]:
        """Return (R,) whether parallel rays from (R, 3) origins in ``map`` hit anything.

        Args:
            origins_m: Points above the ground.
            direction: (3,) unit vector.
        """
        x, y, z = direction.tolist()
        cone = RayCone((x, y, z))
        found = np.zeros(len(origins_m), np.bool_)
        left = origins_m
        for target in self._targets:
            rows = np.flatnonzero(~found)
            if len(rows) < len(left):
                left = take_rows(origins_m, rows)
            found[rows] = target.occludes(left, np.broadcast_to(direction, left.shape), cone)
        return found

    def are_occluded(
        self, origins_m: FloatArray, directions: FloatArray, cone: RayCone | None = None
    ) -> NDArray[np.bool_]:
        """Return (R,) whether rays in (R, 3) directions from (R, 3) origins hit anything.

        If the origins are above the ground, a ``cone`` of all the rays saves time.
        """
        found = np.zeros(len(origins_m), np.bool_)
        rows, left = np.arange(len(found)), (origins_m, directions)
        # Objects first: they hide more than the ground where shadows are looked at closely.
        for target in (*self._targets[1:], self._ground_target):
            is_hidden = target.occludes(*left, cone)
            if not is_hidden.any():
                continue
            found[rows[is_hidden]] = True
            rows = rows[~is_hidden]
            if not len(rows):
                break
            left = take_rows(origins_m, rows), take_rows(directions, rows)
        return found

    def is_far_ground(self, view: View) -> NDArray[np.bool_]:
        """Return (H, W) which pixels show the ground beyond the stage."""
        if self._far_ground is None:
            return np.zeros(view.targets.shape, np.bool_)
        return np.asarray(view.targets == len(self._targets) - 1)

    def ground_triangles(self) -> TriangleMesh:
        """Return the triangles of the stage, in the order of its elements, without ids."""
        return self._ground or ground_mesh(self._scene)

    def object_heights_m(
        self, xy_m: FloatArray, below_m: FloatArray
    ) -> tuple[FloatArray, NDArray[np.uint32]]:
        """Return the (N,) heights of the topmost objects below a height, and their instance ids.

        NaN and 0 where there is none.

        Args:
            xy_m: (N, 2) in ``map``.
            below_m: (N,); ``+inf`` for all heights.
        """
        height_m = np.full(len(xy_m), np.nan)
        ids = np.zeros(len(xy_m), np.uint32)
        down = np.broadcast_to((0.0, 0.0, -1.0), (len(xy_m), 3))
        for target in self._targets:
            if target is self._ground_target or target is self._far_ground:
                continue
            start_m = np.minimum(below_m, target.top_m + 1.0)
            found_m, elements = target.intersect(np.column_stack((xy_m, start_m)), down)
            found_m = start_m - found_m
            higher = np.flatnonzero(np.isfinite(found_m) & ~(found_m <= height_m))
            height_m[higher] = found_m[higher]
            ids[higher] = target.instance_ids_of(elements[higher])
        return height_m, ids

    def own_albedo(self, view: View) -> FloatArray | None:
        """Return the (H, W, 3) linear albedo where objects have images; elsewhere NaN.

        None: nothing has an image, as in most scenes.
        """
        with_images = [each for each in enumerate(self._targets) if each[1].has_images]
        if not with_images:
            return None
        albedo = np.full(view.points_m.shape, np.nan)
        for index, target in with_images:
            seen = (view.targets == index) & (view.instance_ids > 0)
            albedo[seen] = target.albedo_of(view.elements[seen], view.points_m[seen])
        return albedo

    def height_m(self, xy_m: FloatArray) -> FloatArray:
        """Return the (N,) heights of the topmost surface at (N, 2) points, NaN where there is none.

        Land beyond the stage counts, but neither a plain nor grass of the ground.
        """
        height_m = self._scene.ground.height_at(xy_m)
        for target in self._targets:
            if target not in self._objects.cover_targets:
                height_m = np.fmax(height_m, target.surface_height_m(xy_m))
        return height_m

    def mesh(self) -> TriangleMesh:
        """Return all triangles with ids.

        Solids are tessellated; a triangle of the ground has the semantic id at its centroid.
        """
        ground = self._ground or ground_mesh(self._scene)
        centres_m = ground.vertices_m[ground.triangles, :2].mean(axis=1)
        labelled = replace(
            ground,
            semantic_ids=self._scene.material.semantic_ids_at(centres_m),
            instance_ids=np.zeros(len(ground.triangles), dtype=np.uint32),
        )
        solids = [
            merge_instances(
                tessellate(p), p.T_map_object[None], p.semantic_ids, np.array([p.instance_id])
            )
            for p in self._scene.primitives
        ]
        return merge_meshes([labelled, *self._objects.meshes(), *solids])
