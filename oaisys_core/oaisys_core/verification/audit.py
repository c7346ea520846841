"""The label-geometry audit: depth and labels of rendered views against an independent ray cast.

The reference shares no code with the renderers: its rays come from OpenCV's camera model, NumPy
alone meets them with the triangles of the exported ground-truth mesh (the renderers' rays are
cast by Embree), and OpenCV interpolates the blend masks where they hit. As that is slow, squares
of pixels are compared, drawn at random. A pixel is off edges where the reference sees one thing
with one label in the eight pixels around it too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.geometry import pose_looking_at
from oaisys_core.simulation import Simulation
from oaisys_core.types import (
    DEPTH,
    INSTANCE,
    Frame,
    ModuleMetadata,
    PinholeIntrinsics,
    Pose,
    Sample,
    semantic_level,
)
from oaisys_core.verification.reference_scene import ReferenceScene, ReferenceView, Window

HEIGHTS_M = (1.5, 15.0)
PITCHES_DEG = (5.0, 89.0)
"""Ranges of the views that are drawn: height over the surface, and pitch downwards."""


@dataclass(frozen=True)
class AuditResult:
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

    def __add__(self, other: AuditResult) -> AuditResult:
        return replace(
            self,
            pixels=self.pixels + other.pixels,
            wrong=self.wrong + other.wrong,
            worst_m=max(self.worst_m, other.worst_m),
        )


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
) -> list[AuditResult]:
    """Render random views of the world that stands and return what is wrong with their pixels.

    Args:
        simulation: With a world, see `Simulation.step_batch`.
        views: How many.
        rng: Gives the views.
        on_view: Told the number of views that are done.
    """
    everything: list[AuditResult] = []
    reference: ReferenceScene | None = None
    for index in range(views):
        metadata = ModuleMetadata(sensor={"pose": random_view(simulation, rng)})
        sample = simulation.step_sample(metadata)
        if reference is None or simulation.scene.differs_from(reference.scene):
            reference = ReferenceScene(simulation.scene, simulation.ground_truth_mesh())
        everything.extend(audit_sample(sample, reference, rng))
        on_view(index + 1)
    return sum_results(everything)


def sum_results(found: Iterable[AuditResult]) -> list[AuditResult]:
    """Return one sum for each sensor and modality."""
    totals: dict[tuple[str, str], AuditResult] = {}
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
    sample: Sample, reference: ReferenceScene, rng: np.random.Generator
) -> Iterable[AuditResult]:
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
        yield sum_results(found)[0]


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
    frame: Frame, seen: ReferenceView, reference: ReferenceScene, level: int | None
) -> AuditResult:
    if frame.modality == DEPTH:
        inner = _off_edges(seen.instance_ids, np.isfinite(seen.depth_m))
        known, told = seen.depth_m[inner], frame.data[inner].astype(np.float64)
        error_m = np.abs(np.subtract(told, known, where=told != known, out=np.zeros_like(known)))
        wrong = ~(error_m <= DEPTH_TOLERANCE * known)
        wrong &= told != known
        worst_m = float(error_m.max(initial=0.0))
        return AuditResult(
            frame.sensor, frame.modality, int(inner.sum()), int(wrong.sum()), worst_m
        )
    expected = seen.instance_ids if level is None else reference.semantic_ids(seen, level)
    inner = _off_edges(seen.instance_ids, np.isfinite(seen.depth_m), expected)
    wrong = frame.data[inner] != expected[inner]
    return AuditResult(frame.sensor, frame.modality, int(inner.sum()), int(wrong.sum()))


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
