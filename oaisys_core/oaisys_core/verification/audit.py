"""The label-geometry audit: depth and labels of rendered views against an independent ray cast.

The reference shares no code with the renderers: its rays come from OpenCV's camera model, NumPy
alone meets them with the triangles of the exported ground-truth mesh (the renderers' rays are
cast by Embree), and OpenCV interpolates the blend masks where they hit. As that is slow, squares
of pixels are compared, drawn at random. A pixel is off edges where the reference sees one thing
with one label in the eight pixels around it too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.raycast.far_plain import LEVEL, SLOPE, rings, stage_of
from oaisys_core.geometry import pose_looking_at
from oaisys_core.scene import Scene, TerrainMaterial, id_of_level
from oaisys_core.simulation import Simulation
from oaisys_core.types import (
    DEPTH,
    INSTANCE,
    FloatArray,
    Frame,
    ModuleMetadata,
    PinholeIntrinsics,
    Pose,
    Sample,
    TriangleMesh,
    semantic_level,
)
from oaisys_core.verification.numpy_caster import NO_TRIANGLE, NumpyCaster

GROUND_OR_SKY = 0
"""Instance id of what is no object."""

HEIGHTS_M = (1.5, 15.0)
PITCHES_DEG = (5.0, 89.0)
"""Ranges of the views that are drawn: height over the surface, and pitch downwards."""


@dataclass(frozen=True)
class Audited:
    """What was found in the images of one modality.

    Attributes:
        sensor, modality: Whose images.
        pixels: Off edges, compared.
        wrong: Of them: another id, or a depth off by more than one part in 10,000.
        worst_m: Largest error of a depth; 0 for labels.
    """

    sensor: str
    modality: str
    pixels: int
    wrong: int
    worst_m: float = 0.0

    @property
    def wrong_share(self) -> float:
        """Share of wrong pixels, 0 to 1."""
        return self.wrong / self.pixels if self.pixels else 0.0

    def __add__(self, other: Audited) -> Audited:
        return replace(
            self,
            pixels=self.pixels + other.pixels,
            wrong=self.wrong + other.wrong,
            worst_m=max(self.worst_m, other.worst_m),
        )


Window = tuple[slice, slice]
"""Rows and columns of an image."""

WINDOWS, WINDOW_PX = 16, 10
"""Squares of pixels that are compared of each image, and their edge; the outermost pixels only
tell where edges are."""

DEPTH_TOLERANCE = 1e-4
"""Relative; a triangle that is seen almost edge-on is known to no better in float32."""


def audit_views(
    simulation: Simulation,
    views: int,
    rng: np.random.Generator,
    on_view: Callable[[int], None] = lambda _: None,
) -> list[Audited]:
    """Render random views of the world that stands and return what is wrong with their pixels.

    Args:
        simulation: With a world, see `Simulation.step_batch`.
        views: How many.
        rng: Gives the views.
        on_view: Told the number of views that are done.
    """
    everything: list[Audited] = []
    reference: Reference | None = None
    for index in range(views):
        metadata = ModuleMetadata(sensor={"pose": random_view(simulation, rng)})
        sample = simulation.step_sample(metadata)
        if reference is None or simulation.scene.differs_from(reference.scene):
            reference = Reference(simulation.scene, simulation.ground_truth_mesh())
        everything.extend(audit_sample(sample, reference, rng))
        on_view(index + 1)
    return summed(everything)


def summed(found: Iterable[Audited]) -> list[Audited]:
    """Return one sum for each sensor and modality."""
    totals: dict[tuple[str, str], Audited] = {}
    for one in found:
        key = (one.sensor, one.modality)
        totals[key] = totals[key] + one if key in totals else one
    return list(totals.values())


def random_view(simulation: Simulation, rng: np.random.Generator) -> Pose:
    """Return a pose over the stage's inner part that looks down on it at some angle."""
    x0, y0, x1, y1 = simulation.scene.ground.extent_m
    low, high = np.array((x0, y0)), np.array((x1, y1))
    while True:
        xy = rng.uniform(low + 0.2 * (high - low), high - 0.2 * (high - low))
        surface_m = simulation.query_height([(*xy, 0.0)]).surface_height_m[0]
        yaw_rad, pitch_rad = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(*PITCHES_DEG))
        height_m = rng.uniform(*HEIGHTS_M)
        if np.isfinite(surface_m):
            break
    eye = np.array((*xy, surface_m + height_m))
    ahead = np.array((np.cos(yaw_rad), np.sin(yaw_rad), -np.tan(pitch_rad)))
    return pose_looking_at(eye, eye + ahead)


def audit_sample(
    sample: Sample, reference: Reference, rng: np.random.Generator
) -> Iterable[Audited]:
    """Yield what is wrong with samples of each frame of depth, instances and labels.

    Args:
        sample: What was rendered.
        reference: Of the same world.
        rng: Chooses the squares of pixels that are compared.
    """
    views: dict[str, list[tuple[Window, ReferenceView]]] = {}
    for frame in sample.frames:
        level = semantic_level(frame.modality)
        if level is None and frame.modality not in (DEPTH, INSTANCE):
            continue
        if frame.sensor not in views:
            windows = random_windows(frame.intrinsics, rng)
            seen = reference.views(frame.intrinsics, frame.T_map_camera, windows)
            views[frame.sensor] = list(zip(windows, seen, strict=True))
        found = [
            _audit_window(replace(frame, data=frame.data[window]), seen, reference, level)
            for window, seen in views[frame.sensor]
        ]
        yield summed(found)[0]


def random_windows(intrinsics: PinholeIntrinsics, rng: np.random.Generator) -> list[Window]:
    """Return rows and columns of `WINDOWS` squares of an image."""
    sizes = (intrinsics.height_px, intrinsics.width_px)
    edges = [min(WINDOW_PX, size) for size in sizes]
    windows = []
    for _ in range(WINDOWS):
        first = [
            int(rng.integers(size - edge + 1)) for size, edge in zip(sizes, edges, strict=True)
        ]
        windows.append((slice(first[0], first[0] + edges[0]), slice(first[1], first[1] + edges[1])))
    return windows


def _audit_window(
    frame: Frame, seen: ReferenceView, reference: Reference, level: int | None
) -> Audited:
    if frame.modality == DEPTH:
        inner = _off_edges(seen.instance_ids, np.isfinite(seen.depth_m))
        known, told = seen.depth_m[inner], frame.data[inner].astype(np.float64)
        error_m = np.abs(np.subtract(told, known, where=told != known, out=np.zeros_like(known)))
        wrong = ~(error_m <= DEPTH_TOLERANCE * known)
        wrong &= told != known
        worst_m = float(error_m.max(initial=0.0))
        return Audited(frame.sensor, frame.modality, int(inner.sum()), int(wrong.sum()), worst_m)
    expected = seen.instance_ids if level is None else reference.semantic_ids(seen, level)
    inner = _off_edges(seen.instance_ids, np.isfinite(seen.depth_m), expected)
    wrong = frame.data[inner] != expected[inner]
    return Audited(frame.sensor, frame.modality, int(inner.sum()), int(wrong.sum()))


def _off_edges(*images: NDArray[Any]) -> NDArray[np.bool_]:
    """Return the (H, W) pixels, the outermost left out, around which images are of one value."""
    inner = np.zeros(images[0].shape, bool)
    inner[1:-1, 1:-1] = True
    for image in images:
        padded = np.pad(image, 1, mode="edge")
        rows, cols = image.shape
        for row in range(3):
            for col in range(3):
                inner &= padded[row : row + rows, col : col + cols] == image
    return inner


@dataclass(frozen=True)
class ReferenceView:
    """What the reference sees: (H, W) planar depth (float64) and ids, (H, W, 3) points, rays.

    Attributes:
        is_beyond: (H, W) whether it is ground beyond the stage.
    """

    depth_m: FloatArray
    instance_ids: NDArray[np.uint32]
    points_m: FloatArray
    directions: FloatArray
    is_beyond: NDArray[np.bool_]


class Reference:
    """An independent view of a world, from its exported mesh and what lies beyond the stage."""

    def __init__(self, scene: Scene, mesh: TriangleMesh) -> None:
        self.scene = scene
        self._vertices_m = mesh.vertices_m.astype(np.float64)
        self._triangles = mesh.triangles.astype(np.int64)
        self._ids = np.asarray(mesh.instance_ids, np.uint32)
        self._stage_triangles = len(mesh.triangles)
        if scene.sky.shows_plain:
            vertices_m, triangles = rings(stage_of(scene.ground), (*SLOPE, *LEVEL))
            self._triangles = np.concatenate((self._triangles, triangles + len(self._vertices_m)))
            self._vertices_m = np.concatenate((self._vertices_m, vertices_m))
            self._ids = np.concatenate((self._ids, np.zeros(len(triangles), np.uint32)))

    def views(
        self, intrinsics: PinholeIntrinsics, T_map_camera: FloatArray, windows: Sequence[Window]
    ) -> Iterable[ReferenceView]:
        """Yield what a camera with its optical frame at ``T_map_camera`` sees in windows."""
        rays = _camera_rays(intrinsics)
        R, origin_m = T_map_camera[:3, :3], T_map_camera[:3, 3]
        caster = NumpyCaster((self._vertices_m - origin_m) @ R, self._triangles)
        for window in windows:
            depth_m, triangles = caster.nearest(rays[window])
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


def ground_labels(material: TerrainMaterial, xy_m: FloatArray, level: int) -> NDArray[np.uint16]:
    """Return the (N,) ids of the heaviest layer at (N, 2) points, by OpenCV's interpolation.

    Soft borders and label images have one definition, the material's own; only where the point
    lies is independent then.
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
    weights = np.stack([_remapped(mask, texels) for mask in material.masks])
    ids = np.array([id_of_level(la.semantic_ids, level) for la in material.layers], np.uint16)
    return np.asarray(ids[weights.argmax(axis=0)])


MOST_COLUMNS = 32_000
"""OpenCV addresses pixels of its destination with 16 bits."""


def _remapped(mask: NDArray[np.float32], texels: FloatArray) -> NDArray[np.float32]:
    """Return the (N,) values at (N, 2) texels; OpenCV's own steps are 1/32 of one, so twofold."""
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
    for first in range(0, len(place), MOST_COLUMNS):
        x, y = place[first : first + MOST_COLUMNS].T
        yield x[None].copy(), y[None].copy()


def _camera_rays(intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return the (H, W, 3) rays through pixel centres in the optical frame, scaled to z = 1."""
    rows, cols = np.mgrid[: intrinsics.height_px, : intrinsics.width_px]
    pixels = np.stack((cols, rows), axis=-1).reshape(-1, 1, 2).astype(np.float64)
    distortion = np.array(intrinsics.distortion or (0.0,) * 5)
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    # OpenCV 5 has taken the name away and the parameter into the other function.
    if hasattr(cv2, "undistortPointsIter"):
        flat = cv2.undistortPointsIter(pixels, intrinsics.K, distortion, None, None, stop)
    else:
        flat = cv2.undistortPoints(pixels, intrinsics.K, distortion, criteria=stop)
    rays = np.ones((*rows.shape, 3))
    rays[..., :2] = flat.reshape(*rows.shape, 2)
    return rays
