"""The audit: depth and labels of rendered views are compared with an independent ray cast.

The reference, see `reference_scene`, shares no code with the renderers. As it is slow, only random
squares of pixels are compared. Pixels at edges are excluded: the reference must see the same object
and label in the eight pixels around a pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.geometry import pose_looking_at
from oaisys_core.scene.objects import FIRST_COVER_ID
from oaisys_core.simulation import Simulation
from oaisys_core.types import (
    DEPTH,
    DEPTH_TRUE,
    INSTANCE,
    Frame,
    ModuleMetadata,
    PinholeIntrinsics,
    Pose,
    Sample,
    semantic_level,
)
from oaisys_core.verification.reference_scene import (
    GROUND_OR_SKY,
    ReferenceScene,
    ReferenceView,
    Window,
)

HEIGHTS_M = (1.5, 15.0)
PITCHES_DEG = (5.0, 89.0)
"""Ranges of random views: height above the surface, and downward pitch."""


@dataclass(frozen=True)
class AuditResult:
    """The result for the images of one modality.

    Attributes:
        sensor, modality: Names of sensor and modality.
        pixels: Number of compared pixels, without those at edges.
        wrong: Number of them with another id, or a depth error above 1 in 10,000.
        worst_m: Largest depth error; 0 for labels.
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
"""Number and edge length of the compared squares of an image; their outermost pixels only serve to
find edges."""

LEAST_EDGE_PX = 3
"""Edge of the smallest image that has a pixel with eight around it."""

DEPTH_TOLERANCE = 1e-4
"""Relative tolerance: float32 is not more precise for triangles seen almost edge-on."""


def audit_views(
    simulation: Simulation,
    views: int,
    rng: np.random.Generator,
    on_view: Callable[[int], None] = lambda _: None,
) -> list[AuditResult]:
    """Render random views of the current world and compare them with the reference.

    Args:
        simulation: A simulation with a world, see `Simulation.step_batch`.
        views: Number of views.
        rng: Draws the views.
        on_view: Receives the number of finished views.
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
    """Return one sum of results per sensor and modality."""
    totals: dict[tuple[str, str], AuditResult] = {}
    for one in found:
        key = (one.sensor, one.modality)
        totals[key] = totals[key] + one if key in totals else one
    return list(totals.values())


def random_view(simulation: Simulation, rng: np.random.Generator) -> Pose:
    """Return a random pose above the inner part of the stage, looking down at an angle."""
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


def is_audited(modality: str) -> bool:
    """Return whether images of a modality are compared: depth, instances and labels."""
    return semantic_level(modality) is not None or modality in (DEPTH, DEPTH_TRUE, INSTANCE)


def audit_sample(
    sample: Sample, reference: ReferenceScene, rng: np.random.Generator
) -> Iterable[AuditResult]:
    """Return the results of the frames of depth, instances and labels.

    Args:
        sample: The rendered sample.
        reference: The reference of the same world.
        rng: Draws the squares of pixels that are compared.
    """
    return audit_frames(sample.frames, reference, rng)


def audit_frames(
    frames: Iterable[Frame], reference: ReferenceScene, rng: np.random.Generator
) -> Iterable[AuditResult]:
    """Yield the result of each frame of depth, instances and labels; see `audit_sample`."""
    views: dict[str, list[tuple[Window, ReferenceView]]] = {}
    for frame in frames:
        if not is_audited(frame.modality):
            continue
        level = semantic_level(frame.modality)
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
    """Return the rows and columns of `WINDOWS` random squares of an image."""
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
    if frame.modality in (DEPTH, DEPTH_TRUE):
        inner = _off_edges(seen.instance_ids, np.isfinite(seen.depth_m))
        known, rendered = seen.depth_m[inner], frame.data[inner].astype(np.float64)
        error_m = np.abs(
            np.subtract(rendered, known, where=rendered != known, out=np.zeros_like(known))
        )
        wrong = ~(error_m <= DEPTH_TOLERANCE * known)
        wrong &= rendered != known
        worst_m = float(error_m.max(initial=0.0))
        return AuditResult(
            frame.sensor, frame.modality, int(inner.sum()), int(wrong.sum()), worst_m
        )
    if level is None:
        # What belongs to the ground has ids of its own, which images do not show.
        expected = np.where(seen.instance_ids < FIRST_COVER_ID, seen.instance_ids, GROUND_OR_SKY)
    else:
        expected = reference.semantic_ids(seen, level)
    inner = _off_edges(seen.instance_ids, np.isfinite(seen.depth_m), expected)
    wrong = frame.data[inner] != expected[inner]
    return AuditResult(frame.sensor, frame.modality, int(inner.sum()), int(wrong.sum()))


def _off_edges(*images: NDArray[Any]) -> NDArray[np.bool_]:
    """Return (H, W) which inner pixels have the same values as their eight neighbours."""
    inner = np.zeros(images[0].shape, bool)
    inner[1:-1, 1:-1] = True
    for image in images:
        padded = np.pad(image, 1, mode="edge")
        rows, cols = image.shape
        for row in range(3):
            for col in range(3):
                inner &= padded[row : row + rows, col : col + cols] == image
    return inner
