"""What an image shows of each object: its pose, its boxes, and how much of it is hidden."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.instance_boxes import BoxInstanceTarget
from oaisys_core.raycast.prototype_meshes import PlacedPrototype, PrototypeMesh
from oaisys_core.raycast.silhouettes import HitTest, Silhouettes, box_corners
from oaisys_core.raycast.solids import target_of
from oaisys_core.raycast.triangles import NO_ELEMENT
from oaisys_core.scene import Placement, Primitive, Scene, id_of_level
from oaisys_core.types import FloatArray, PinholeIntrinsics, ShortRepr


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
class _Found:
    """An object of a scene that an image shows; ``cast`` casts rays from a point in ``map``."""

    instance_id: int
    semantic_id: int
    body: Body
    T_map_object: FloatArray
    cast: Callable[[FloatArray, FloatArray], NDArray[np.bool_]]


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
        ids, counts, boxes = _visible(instance)
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

    def _objects(self, scene: Scene, ids: NDArray[np.int64]) -> Iterator[_Found]:
        """Yield the objects of a scene that have one of some ids."""
        for placement in scene.placements:
            rows = np.flatnonzero(np.isin(placement.instance_ids, ids))
            if len(rows):
                mesh, body = self._mesh(scene, placement)
                for row in rows.tolist():
                    yield _instance(mesh, body, placement, row)
        for primitive in scene.primitives:
            if primitive.instance_id in ids:
                yield _solid(primitive)

    def _mesh(self, scene: Scene, placement: Placement) -> tuple[PrototypeMesh, Body]:
        prototype = scene.prototypes[placement.prototype]
        if id(prototype) not in self._meshes:
            mesh = PrototypeMesh(prototype)
            self._meshes[id(prototype)] = mesh, _body_of(mesh)
        return self._meshes[id(prototype)]


def _visible(
    instance: NDArray[Any],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the ids of the objects in an image, their numbers of pixels, and their boxes."""
    from scipy import ndimage

    ids, inverse, counts = np.unique(instance, return_inverse=True, return_counts=True)
    slices = ndimage.find_objects(inverse.reshape(instance.shape) + 1)
    boxes = np.array(
        [(x.start, y.start, x.stop - x.start, y.stop - y.start) for y, x in slices], np.int64
    ).reshape(-1, 4)
    is_object = ids > 0
    return ids[is_object].astype(np.int64), counts[is_object], boxes[is_object]


def _instance(mesh: PrototypeMesh, body: Body, placement: Placement, row: int) -> _Found:
    """Return one instance of a placement."""
    T = placement.T_map_object[row]

    def cast(eye_m: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
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

    semantic_id = id_of_level(placement.semantic_ids, 0)
    return _Found(int(placement.instance_ids[row]), semantic_id, body, T, cast)


def _solid(primitive: Primitive) -> _Found:
    """Return an exact solid."""
    is_sphere = primitive.shape == "sphere"
    half_m = np.array([primitive.size_m[0]] * 3 if is_sphere else primitive.size_m, np.float64)
    half_m = half_m if is_sphere else half_m / 2
    diameter_m = 2 * primitive.size_m[0] if is_sphere else 2 * float(np.linalg.norm(half_m))
    sha256 = hashlib.sha256(f"{primitive.shape} {half_m.tolist()}".encode()).hexdigest()
    target = target_of(primitive)

    def cast(eye_m: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        return np.asarray(target.intersect(eye_m, directions)[1] != NO_ELEMENT)

    body = Body(sha256, -half_m, half_m, diameter_m)
    semantic_id = id_of_level(primitive.semantic_ids, 0)
    return _Found(primitive.instance_id, semantic_id, body, primitive.T_map_object, cast)


def _body_of(mesh: PrototypeMesh) -> Body:
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


def _measure(
    found: _Found,
    silhouettes: Silhouettes,
    T_map_camera: FloatArray,
    instance: NDArray[Any],
    box_px: NDArray[np.int64],
) -> tuple[int, int, tuple[int, int, int, int]]:
    """Return the pixels of a silhouette, those in the image, and its box.

    Pixels that show the object belong to its silhouette even where rounding makes its rays miss.
    """
    eye_m, R = T_map_camera[:3, 3], T_map_camera[:3, :3]
    T = found.T_map_object
    corners_m = box_corners(found.body.low_m, found.body.high_m) @ T[:3, :3].T + T[:3, 3]
    test: HitTest = lambda rays: found.cast(eye_m, rays @ R.T)  # noqa: E731
    pixels, weights = silhouettes.pixels((corners_m - eye_m) @ R, test)
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


def _views(
    objects: list[_Found],
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
