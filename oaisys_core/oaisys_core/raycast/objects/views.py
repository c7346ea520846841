"""What an image shows of each object: its pose, its boxes, and how much of it is hidden."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import NotFoundError
from oaisys_core.geometry.pixel_boxes import pixel_boxes
from oaisys_core.raycast.objects.silhouettes import Silhouettes, box_corners
from oaisys_core.raycast.objects.single_objects import (
    Body,
    SingleObject,
    body_of,
    single_instance,
    single_solid,
)
from oaisys_core.raycast.prototype_meshes import PrototypeMesh
from oaisys_core.scene import Placement, Scene
from oaisys_core.types import FloatArray, PinholeIntrinsics, ShortRepr, TriangleMesh


@dataclass(frozen=True, repr=False)
class ObjectViews(ShortRepr):
    """The N objects of which an image shows at least one pixel, in the order of their ids.

    A box in the image is (left, top, width, height) in pixels from the image's corner. Silhouettes
    are those of each object alone, as if nothing hid it; see `Silhouettes.pixels` for how far they
    go on beyond the image.

    Attributes:
        instance_ids: (N,) uint32.
        semantic_ids: (N,) uint16, level 0.
        mesh_sha256: Hash of each object's shape at a scale of 1.
        T_map_object: (N, 4, 4) rigid poses of the objects' frames, whose origin is the centre of
            the base, of a solid its centre.
        scale: (N,) factor on the shape.
        low_m, high_m: (N, 3) corners of the box along the object's axes, in its frame.
        diameter_m: (N,) largest distance of two points.
        visible_px: (N,) int64 pixels of the image that show it.
        silhouette_px: (N,) int64 pixels of its silhouette.
        silhouette_in_image_px: (N,) int64 those of them that are in the image.
        box_visible_px: (N, 4) int64 box of the pixels that show it.
        box_amodal_px: (N, 4) int64 box of its silhouette.
    """

    instance_ids: NDArray[np.uint32]
    semantic_ids: NDArray[np.uint16]
    mesh_sha256: tuple[str, ...]
    T_map_object: FloatArray
    scale: FloatArray
    low_m: FloatArray
    high_m: FloatArray
    diameter_m: FloatArray
    visible_px: NDArray[np.int64]
    silhouette_px: NDArray[np.int64]
    silhouette_in_image_px: NDArray[np.int64]
    box_visible_px: NDArray[np.int64]
    box_amodal_px: NDArray[np.int64]


class ObjectFinder:
    """Describes the objects in images of a world; keeps what it needs of meshes between images."""

    def __init__(self) -> None:
        self._meshes: dict[int, tuple[PrototypeMesh, Body]] = {}

    def find(
        self,
        scene: Scene,
        camera: PinholeIntrinsics,
        T_map_camera: FloatArray,
        instance: NDArray[Any],
    ) -> ObjectViews:
        """Return the objects in an image.

        Args:
            scene: The world at the time of the image.
            camera: The camera.
            T_map_camera: (4, 4) pose of its optical frame; of a rolling shutter, its first row's.
            instance: (H, W) ids of the objects.
        """
        ids, counts, boxes = pixel_boxes(instance)
        kept = {id(prototype) for prototype in scene.prototypes}
        self._meshes = {key: each for key, each in self._meshes.items() if key in kept}
        found = {each.instance_id: each for each in self._objects(scene, ids)}
        chosen = [index for index, each in enumerate(ids.tolist()) if each in found]
        silhouettes = Silhouettes(camera)
        parts = [
            _measure(found[int(ids[i])], silhouettes, T_map_camera, instance, boxes[i])
            for i in chosen
        ]
        objects = [found[int(ids[i])] for i in chosen]
        return _views(objects, counts[chosen], boxes[chosen], parts)

    def masks(
        self,
        scene: Scene,
        camera: PinholeIntrinsics,
        T_map_camera: FloatArray,
        T_map_objects: Mapping[int, FloatArray],
    ) -> dict[int, NDArray[np.bool_]]:
        """Return the (H, W) silhouettes of objects in an image by id.

        Args:
            scene: A world that has the objects.
            camera: The camera.
            T_map_camera: (4, 4) pose of its optical frame.
            T_map_objects: (4, 4) poses times scales, by id, which may differ from the scene's.
        """
        silhouettes, masks = Silhouettes(camera), {}
        for each in self._objects(scene, np.array(list(T_map_objects), np.int64)):
            placed = replace(each, T_map_object=T_map_objects[each.instance_id])
            mask = np.zeros((camera.height_px, camera.width_px), np.bool_)
            pixels, _ = _silhouette(placed, silhouettes, T_map_camera)
            columns, rows = pixels[silhouettes.is_in_image(pixels)].astype(np.int64).T
            mask[rows, columns] = True
            masks[each.instance_id] = mask
        return masks

    def mesh(self, scene: Scene, instance_id: int) -> TriangleMesh:
        """Return the triangles of an object at a scale of 1, in its own frame.

        Raises:
            NotFoundError: The scene has no such object.
        """
        for each in self._objects(scene, np.array([instance_id])):
            return each.mesh()
        raise NotFoundError(f"object {instance_id}: not in this world")

    def _objects(self, scene: Scene, ids: NDArray[np.int64]) -> Iterator[SingleObject]:
        """Yield the objects of a scene that have one of some ids."""
        for placement in scene.placements:
            rows = np.flatnonzero(np.isin(placement.instance_ids, ids))
            if len(rows):
                mesh, body = self._mesh(scene, placement)
                for row in rows.tolist():
                    yield single_instance(mesh, body, placement, row)
        for primitive in scene.primitives:
            if primitive.instance_id in ids:
                yield single_solid(primitive)

    def _mesh(self, scene: Scene, placement: Placement) -> tuple[PrototypeMesh, Body]:
        prototype = scene.prototypes[placement.prototype]
        if id(prototype) not in self._meshes:
            mesh = PrototypeMesh(prototype)
            self._meshes[id(prototype)] = mesh, body_of(mesh)
        return self._meshes[id(prototype)]


def _measure(
    found: SingleObject,
    silhouettes: Silhouettes,
    T_map_camera: FloatArray,
    instance: NDArray[Any],
    box_px: NDArray[np.int64],
) -> tuple[int, int, tuple[int, int, int, int]]:
    """Return the pixels of a silhouette, those in the image, and its box.

    Pixels that show the object belong to its silhouette even where rounding makes its rays miss.
    """
    pixels, weights = _silhouette(found, silhouettes, T_map_camera)
    inside = silhouettes.is_in_image(pixels)
    columns, rows = pixels[inside].astype(np.int64).T
    hidden = int(np.count_nonzero(instance[rows, columns] != found.instance_id))
    left, top, width, height = box_px.tolist()
    visible = np.count_nonzero(
        instance[top : top + height, left : left + width] == found.instance_id
    )
    ends = np.array([(left, top), (left + width - 1, top + height - 1)], np.float64)
    pixels = np.concatenate((pixels, ends))
    low, high = pixels.min(axis=0).astype(int), pixels.max(axis=0).astype(int) + 1
    in_image = int(visible) + hidden
    whole = in_image + round(float(weights[~inside].sum()))
    return whole, in_image, (int(low[0]), int(low[1]), int((high - low)[0]), int((high - low)[1]))


def _silhouette(
    found: SingleObject, silhouettes: Silhouettes, T_map_camera: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the pixels of an object's silhouette, see `Silhouettes.pixels`."""
    eye_m, R = T_map_camera[:3, 3], T_map_camera[:3, :3]
    T = found.T_map_object
    corners_m = box_corners(found.body.low_m, found.body.high_m) @ T[:3, :3].T + T[:3, 3]

    def is_hit(rays: FloatArray) -> NDArray[np.bool_]:
        return found.cast(T, eye_m, rays @ R.T)

    return silhouettes.pixels((corners_m - eye_m) @ R, is_hit)


def _views(
    objects: list[SingleObject],
    counts: NDArray[np.int64],
    boxes: NDArray[np.int64],
    parts: list[tuple[int, int, tuple[int, int, int, int]]],
) -> ObjectViews:
    n = len(objects)
    T = np.array([each.T_map_object for each in objects], np.float64).reshape(n, 4, 4).copy()
    scale = np.cbrt(np.linalg.det(T[:, :3, :3]))
    T[:, :3, :3] /= scale[:, None, None]
    low_m = np.array([each.body.low_m for each in objects]).reshape(n, 3)
    high_m = np.array([each.body.high_m for each in objects]).reshape(n, 3)
    diameter_m = np.array([each.body.diameter_m for each in objects], np.float64)
    return ObjectViews(
        instance_ids=np.array([each.instance_id for each in objects], np.uint32),
        semantic_ids=np.array([each.semantic_id for each in objects], np.uint16),
        mesh_sha256=tuple(each.body.sha256 for each in objects),
        T_map_object=T,
        scale=scale,
        low_m=low_m * scale[:, None],
        high_m=high_m * scale[:, None],
        diameter_m=diameter_m * scale,
        visible_px=np.asarray(counts, np.int64),
        silhouette_px=np.array([part[0] for part in parts], np.int64),
        silhouette_in_image_px=np.array([part[1] for part in parts], np.int64),
        box_visible_px=np.asarray(boxes, np.int64).reshape(n, 4),
        box_amodal_px=np.array([part[2] for part in parts], np.int64).reshape(n, 4),
    )
