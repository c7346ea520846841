"""An independent view of a world, as the reference of the audit: slow, and without Embree.

Rays come from OpenCV's camera model, NumPy alone intersects them with the triangles of the exported
ground-truth mesh, and OpenCV interpolates the blend masks where the rays hit.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.scene import MeshPrototype, Placement, Scene, TerrainMaterial, id_of_level
from oaisys_core.scene.surroundings import LandMasks
from oaisys_core.types import FloatArray, PinholeIntrinsics, TriangleMesh, merge_meshes
from oaisys_core.verification.numpy_caster import NO_TRIANGLE, NumpyCaster
from oaisys_core.verification.triangle_groups import TriangleGroups

GROUND_OR_SKY = 0
"""Instance id of pixels that show no object."""

Window = tuple[slice, slice]
"""Rows and columns of an image."""

MAX_COLUMNS = 32_000
"""OpenCV addresses the pixels of its destination with 16 bits."""


@dataclass(frozen=True)
class ReferenceView:
    """A view of the reference: (H, W) planar depth (float64) and ids, (H, W, 3) points and rays.

    Attributes:
        is_beyond: (H, W) whether a pixel shows ground beyond the stage.
    """

    depth_m: FloatArray
    instance_ids: NDArray[np.uint32]
    points_m: FloatArray
    directions: FloatArray
    is_beyond: NDArray[np.bool_]


class ReferenceScene:
    """The reference scene: the exported ground-truth mesh, and the land around the stage."""

    def __init__(self, scene: Scene, mesh: TriangleMesh) -> None:
        self.scene = scene
        ids = _with_rock_faces(scene, mesh)
        parts = [TriangleMesh(mesh.vertices_m, mesh.triangles, instance_ids=ids)]
        parts += [
            _instances(scene.prototypes[placement.prototype], placement)
            for placement in scene.placements
            if not placement.is_solid
        ]
        self._stage_triangles = sum(len(part.triangles) for part in parts)
        if (land := scene.far_ground) is not None:
            ids = np.zeros(len(land.triangles), np.uint32)
            vertices_m = land.vertices_m.astype(np.float64)
            parts.append(TriangleMesh(vertices_m, land.triangles, instance_ids=ids))
        whole = merge_meshes(parts)
        self._vertices_m, self._triangles = whole.vertices_m, whole.triangles
        self._ids = np.asarray(whole.instance_ids, np.uint32)
        self._groups = TriangleGroups(self._vertices_m, self._triangles, self._ids)

    def views(
        self, intrinsics: PinholeIntrinsics, T_map_camera: FloatArray, windows: Sequence[Window]
    ) -> Iterable[ReferenceView]:
        """Yield the views of a camera at ``T_map_camera`` (4, 4) in windows of its image.

        Raises:
            InvalidInputError: It is a fisheye: this caster sees only what is in front of a camera.
        """
        if intrinsics.is_fisheye:
            model = intrinsics.distortion_model
            raise InvalidInputError("sensors.cameras.fisheye", model, "null: a pinhole camera")
        rays = _camera_rays(intrinsics)
        R, origin_m = T_map_camera[:3, :3], T_map_camera[:3, 3]
        boxes = [_box_of(rays[window]) for window in windows]
        seen = self._groups.visible_in(R, origin_m, boxes)
        used, corners = np.unique(self._triangles[seen], return_inverse=True)
        points_m = (self._vertices_m[used] - origin_m) @ R
        caster = NumpyCaster(points_m, corners.reshape(-1, 3))
        # One more, for rays that hit none.
        seen = np.append(seen, NO_TRIANGLE)
        for window in windows:
            depth_m, places = caster.nearest(rays[window])
            triangles = seen[places]
            directions = rays[window] @ R.T
            with np.errstate(invalid="ignore"):
                points_m = origin_m + depth_m[..., None] * directions
            ids = np.where(triangles == NO_TRIANGLE, 0, self._ids[triangles]).astype(np.uint32)
            is_beyond = triangles >= self._stage_triangles
            yield ReferenceView(depth_m, ids, points_m, directions, is_beyond)

    def semantic_ids(self, seen: ReferenceView, level: int) -> NDArray[np.uint16]:
        """Return the (H, W) labels of a view."""
        scene = self.scene
        by_instance: dict[int, int] = {GROUND_OR_SKY: 0}
        for placement in scene.placements:
            label = id_of_level(placement.semantic_ids, level)
            by_instance.update(dict.fromkeys(placement.instance_ids.tolist(), label))
        for primitive in scene.primitives:
            by_instance[primitive.instance_id] = id_of_level(primitive.semantic_ids, level)
        present, index = np.unique(seen.instance_ids, return_inverse=True)
        labels = np.array([by_instance[i] for i in present.tolist()], np.uint16)
        labels = labels[index].reshape(seen.instance_ids.shape)
        hit = np.isfinite(seen.depth_m)
        ground = hit & (seen.instance_ids == GROUND_OR_SKY)
        labels[ground] = ground_labels(scene.material, seen.points_m[ground][:, :2], level)
        if scene.sky.ground_semantic_ids is not None:
            labels[seen.is_beyond] = id_of_level(scene.sky.ground_semantic_ids, level)
        labels[~hit] = scene.sky.semantic_ids_at(seen.directions[~hit], level)
        return labels


def _with_rock_faces(scene: Scene, mesh: TriangleMesh) -> NDArray[np.uint32]:
    """Return the instance ids of a ground truth mesh's triangles, with those of broken rock.

    It has 0 for them, as the ground, after which they come in the order of their placements.

    Raises:
        InvalidInputError: It has other triangles of broken rock than the scene.
    """
    assert mesh.instance_ids is not None
    assert mesh.semantic_ids is not None
    faces = [placement for placement in scene.placements if placement.is_rock_face]
    counts = [len(scene.prototypes[each.prototype].triangles) for each in faces]
    ids, labels = [np.zeros(0, np.uint32)], [np.zeros(0, np.uint16)]
    for each, count in zip(faces, counts, strict=True):
        ids.append(np.repeat(each.instance_ids, count))
        labels.append(np.full(len(ids[-1]), id_of_level(each.semantic_ids, 0), np.uint16))
    found = np.asarray(mesh.instance_ids, np.uint32).copy()
    of_rock = np.flatnonzero(found == GROUND_OR_SKY)[len(scene.ground.triangles()) :]
    if not np.array_equal(mesh.semantic_ids[of_rock], np.concatenate(labels)):
        expected = f"{sum(map(len, ids))}, with the labels of the scene"
        raise InvalidInputError("mesh", f"{len(of_rock)} triangles of broken rock", expected)
    found[of_rock] = np.concatenate(ids)
    return found


def _instances(prototype: MeshPrototype, placement: Placement) -> TriangleMesh:
    """Return what stands on the land, or is grass, which is no part of the ground-truth mesh.

    Not by the function that merges instances for the rays that are judged.
    """
    poses = placement.T_map_object
    points_m = prototype.vertices_m.astype(np.float64) @ poses[:, :3, :3].swapaxes(1, 2)
    points_m += poses[:, None, :3, 3]
    first = len(prototype.vertices_m) * np.arange(len(poses), dtype=np.int32)
    corners = (first[:, None, None] + prototype.triangles).reshape(-1, 3)
    ids = np.repeat(placement.instance_ids, len(prototype.triangles))
    return TriangleMesh(points_m.reshape(-1, 3), corners, instance_ids=ids)


def ground_labels(material: TerrainMaterial, xy_m: FloatArray, level: int) -> NDArray[np.uint16]:
    """Return the (N,) ids of the layer with the largest weight, interpolated by OpenCV.

    For soft borders and label images, the material's own definition is used.
    """
    plain = material.label_cell_m is None and all(la.label_image is None for la in material.layers)
    if not plain:
        return material.semantic_ids_at(xy_m, level)
    x0, y0, x1, y1 = material.extent_m
    size = material.masks.shape[1]
    texels = np.asarray((xy_m - (x0, y0)) / (x1 - x0, y1 - y0) * size)
    beyond = (texels < 0) | (texels > size)
    there = np.mod(texels[beyond], 2 * size)
    texels[beyond] = np.where(there > size, 2 * size - there, there)
    texels -= 0.5
    weights = np.stack([_remap(mask, texels) for mask in material.masks])
    if material.land is not None:
        outside = np.flatnonzero(beyond.any(axis=1))
        weights[:, outside] = _on_land(material.land, xy_m[outside], weights[:, outside])
    ids = np.array([id_of_level(la.semantic_ids, level) for la in material.layers], np.uint16)
    return np.asarray(ids[weights.argmax(axis=0)])


def _on_land(
    land: LandMasks, xy_m: FloatArray, weights: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return (L, N) weights at (N, 2) points beyond a stage, whose own are ``weights``."""
    x0, y0, x1, y1 = land.extent_m
    offset_m = xy_m - ((x0 + x1) / 2, (y0 + y1) / 2)
    directions, last_row = land.weights.shape[2], land.weights.shape[1] - 1
    columns = np.angle(offset_m @ (1, 1j)) / (2 * np.pi) % 1.0 * directions - 0.5
    e_folds = np.log(np.linalg.norm(offset_m, axis=1) * 2 / min(x1 - x0, y1 - y0))
    rows = np.clip(e_folds * directions / (2 * np.pi), 0, last_row)
    # One more column at either side, because directions go round.
    rounds = [np.pad(mask, ((0, 0), (1, 1)), mode="wrap") for mask in land.weights]
    far = np.stack([_remap(mask, np.column_stack((columns + 1, rows))) for mask in rounds])
    outside_m = np.abs(offset_m) - ((x1 - x0) / 2, (y1 - y0) / 2)
    share = np.linalg.norm(np.maximum(outside_m, 0), axis=1) / land.patch_m
    return np.asarray(weights + (far - weights) * np.minimum(share, 1), np.float32)


def _remap(mask: NDArray[np.float32], texels: FloatArray) -> NDArray[np.float32]:
    """Return (N,) bilinear values at (N, 2) texels; OpenCV alone would round to 1/32 of a texel."""
    low = np.floor(texels)
    step = (texels - low).astype(np.float32)
    corners = []
    for offset in ((0, 0), (1, 0), (0, 1), (1, 1)):
        place = (low + offset).astype(np.float32)
        values = [
            cv2.remap(mask, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE).ravel()
            for x, y in _blocks(place)
        ]
        corners.append(np.concatenate(values) if values else np.zeros(0, np.float32))
    s, t = step.T
    lower, upper = corners[0] * (1 - s) + corners[1] * s, corners[2] * (1 - s) + corners[3] * s
    return np.asarray(lower * (1 - t) + upper * t)


def _blocks(place: NDArray[np.float32]) -> Iterable[tuple[NDArray[Any], NDArray[Any]]]:
    for first in range(0, len(place), MAX_COLUMNS):
        x, y = place[first : first + MAX_COLUMNS].T
        yield x[None].copy(), y[None].copy()


def _box_of(rays: FloatArray) -> FloatArray:
    """Return the (min_x, min_y, max_x, max_y) of (H, W, 3) rays with z = 1."""
    flat = rays[..., :2].reshape(-1, 2)
    return np.concatenate((flat.min(axis=0), flat.max(axis=0)))


def _camera_rays(intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return the (H, W, 3) rays through pixel centres in the optical frame, scaled to z = 1."""
    rows, cols = np.mgrid[: intrinsics.height_px, : intrinsics.width_px]
    pixels = np.stack((cols, rows), axis=-1).reshape(-1, 1, 2).astype(np.float64)
    distortion = np.array(intrinsics.distortion or (0.0,) * 5)
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    # OpenCV 5 merged both functions.
    if hasattr(cv2, "undistortPointsIter"):
        flat = cv2.undistortPointsIter(pixels, intrinsics.K, distortion, None, None, stop)
    else:
        flat = cv2.undistortPoints(pixels, intrinsics.K, distortion, criteria=stop)
    rays = np.ones((*rows.shape, 3))
    rays[..., :2] = flat.reshape(*rows.shape, 2)
    return rays
