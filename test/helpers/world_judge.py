"""Judges what a drawn world looks like: errors, black ground, speckles, holes.

A picture is compared with one of the same view at many samples per pixel, so that the contrast of
textures does not count, and with rays to the sun, so that shadows do not count. The denoiser takes
a part of that contrast away at any number of samples. So where a picture seems to have too many
speckles, it is compared with two that are not denoised as well, whose difference tells their noise.
"""

from __future__ import annotations

import os
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from unittest import mock

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import pixel_rays
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import NO_TARGET
from oaisys_core.simulation import Simulation
from oaisys_core.types import RGB, Frame, ModuleMetadata, Sample
from oaisys_core.world.modules import render

Json = dict[str, Any]
Mask = NDArray[np.bool_]

BLACK = 1
"""Largest value of a channel of a black pixel, of 255; a `raw` picture's are 0."""
BLACK_ALBEDO = 3
"""The same of reflectance: 0.001 linear. The darkest built-in ground has ten times as much."""
MAX_BLACK = 0.01
"""Share of lit pixels that may be black: gaps between stones that no sample's light reached."""

OBJECT_PIXELS = 12
"""Pixels from which on a thing of which no pixel has any albedo is black."""

SPECKLE = 1 / 16
"""Deviation from the neighbours, beyond that of the converged picture there, that is a grain.

One of sixteen grey steps from black to white, which one sees at a glance.
"""
MAX_SPECKLES = 0.01
REFERENCE_SAMPLES = 32
UNDENOISED_SAMPLES, LIGHT_SEEDS = 128, (1, 2)
"""Samples per pixel, and seeds of the light, of the two pictures that are not denoised."""
STANDARD_ERRORS = 3.0
"""Standard errors of their mean that its contrast must exceed: 99.7 % of all noise is less."""
MIN_PIXELS = 300
"""A picture with fewer pixels that can be judged is not."""

MAX_BEND = 0.1
"""Relative second difference of the inverse depth from which a pixel counts as an edge."""
FARTHEST_M = 1e5
LEAST_CONTRAST = 0.02
"""Of what is at the end of the visual range, by Koschmieder's definition of it."""
LOWEST_SUN_DEG = 5.0
"""Elevation of the sun from which the sky lights every place."""
WATER_ID = 300


@dataclass
class Verdict:
    """What was found: one line per fault, and figures of each picture."""

    faults: list[str] = field(default_factory=list)
    figures: list[Json] = field(default_factory=list)


@contextmanager
def standard_error() -> Iterator[list[str]]:
    """Collect what this process writes to its standard error, libraries included."""
    lines: list[str] = []
    with tempfile.TemporaryFile("w+", errors="replace") as file:
        kept = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield lines
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            lines += file.read().splitlines()


def judge(data: Json) -> Verdict:
    """Render a world, and return what is wrong with it."""
    verdict = Verdict()
    with standard_error() as lines:
        try:
            _judge(data, verdict)
        except Exception:  # noqa: BLE001 - whatever happens in a world is a finding
            verdict.faults.append(traceback.format_exc(limit=-4))
    errors = [line for line in lines if "error" in line.lower() or "SVM" in line]
    verdict.faults += list(dict.fromkeys(f"standard error: {line}" for line in errors))[:3]
    return verdict


def _judge(data: Json, verdict: Verdict) -> None:
    config = config_from_mapping(data)
    simulation = Simulation(config)
    try:
        simulation.step_batch()
        sample = simulation.step_sample()
        reference = _again(simulation, REFERENCE_SAMPLES)
        views = [
            _View(data, name, frames_of(sample, name), frames_of(reference, name))
            for name in dict.fromkeys(frame.sensor for frame in sample.frames)
        ]
        if any(view.speckles() > MAX_SPECKLES for view in views):
            for seed in LIGHT_SEEDS:
                with mock.patch.object(render, "LIGHT_SEED", seed):
                    more = _again(simulation, UNDENOISED_SAMPLES, denoise=False)
                for view in views:
                    view.undenoised.append(frames_of(more, view.name)[RGB])
        scene = simulation.scene
        lowest_m = float(np.nanmin(simulation.ground_truth_mesh().vertices_m[:, 2]))
    finally:
        simulation.close()
    surface = Surface(scene, None)
    for view in views:
        figures = view.judge(surface, lowest_m)
        verdict.figures.append(figures)
        verdict.faults += view.faults


def _again(simulation: Simulation, samples: int, **more: object) -> Sample:
    """Render the last sample's pictures again with so many samples per pixel."""
    simulation.withdraw_sample()
    settings = {"samples": samples, "max_samples": samples, **more}
    return simulation.step_sample(ModuleMetadata(render=settings), modalities=(RGB,))


def standing_out(image: NDArray[Any]) -> NDArray[np.float32]:
    """Return by how much pixels differ from the median of their neighbours, from 0 to 1.

    Args:
        image: (H, W, 3) values from 0 to 255.
    """
    shown = image.astype(np.float32) / 255
    return np.asarray(np.abs(shown - cv2.medianBlur(shown, 3)).max(axis=-1))


def certain_contrast(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return `standing_out` of two pictures' mean, without what may be its noise.

    Contrast and noise are independent: their squares add up.

    Args:
        first, second: (H, W, 3) pictures of the same, with independent noise. Half their
            difference has the standard deviation of the noise of their mean.
    """
    both = np.stack((first, second)).astype(np.float32)
    half = (both[0] - both[1]) / (2 * 255)
    # Noise of one level over a few pixels.
    error = np.sqrt(cv2.blur(half * half, (5, 5))).max(axis=-1)
    seen = standing_out(both.mean(axis=0))
    return np.asarray(np.sqrt(np.maximum(seen**2 - (STANDARD_ERRORS * error) ** 2, 0)))


def grains(
    picture: NDArray[np.uint8], denoised: NDArray[np.uint8], undenoised: Sequence[NDArray[np.uint8]]
) -> Mask:
    """Return the (H, W) pixels that stand out from their neighbours, beyond the converged ones.

    Args:
        picture: (H, W, 3) sRGB bytes.
        denoised: The same of many samples per pixel.
        undenoised: Nothing, or two of still more samples, see `certain_contrast`.
    """
    converged = standing_out(denoised)
    if undenoised:
        converged = np.maximum(converged, certain_contrast(*undenoised))
    beside = cv2.dilate(converged, np.ones((3, 3), np.uint8))
    return np.asarray(standing_out(picture) - beside > SPECKLE)


def frames_of(sample: Sample, sensor: str) -> dict[str, Frame]:
    """Return a sensor's frames by modality."""
    return {frame.modality: frame for frame in sample.frames if frame.sensor == sensor}


class _View:
    """The pictures of one camera."""

    def __init__(
        self, data: Json, name: str, frames: dict[str, Frame], reference: dict[str, Frame]
    ) -> None:
        self.data, self.name, self.frames, self.reference = data, name, frames, reference
        self.undenoised: list[Frame] = []
        self.faults: list[str] = []
        camera = frames["depth"]
        self.origin_m = camera.T_map_camera[:3, 3]
        self.rays = pixel_rays(camera.intrinsics)
        self.directions = self.rays @ camera.T_map_camera[:3, :3].T
        self.depth_m = frames["depth"].data.astype(np.float64)
        self.is_hit: Mask = np.isfinite(self.depth_m)
        self.is_water: Mask = frames["semantic_0"].data == WATER_ID
        self.is_ground: Mask = self.is_hit & ~self.is_water & (frames["instance"].data == 0)
        sensors = data["sensors"]["cameras"]
        self.camera: Json = next((each for each in sensors if each["name"] == name), {})

    def judge(self, surface: Surface, lowest_m: float) -> Json:
        """Return figures; faults are added to ``self.faults``."""
        figures: Json = {"camera": self.name, "hit": float(self.is_hit.mean())}
        figures["holes"] = self._holes(lowest_m)
        if figures["holes"]:
            self.faults.append(
                f"{self.name}: {figures['holes']} pixels of the ground have no depth"
            )
        figures |= self._black(surface)
        for kind in ("black", "black_albedo"):
            if figures[kind] > MAX_BLACK:
                self.faults.append(f"{self.name}: {kind} {figures[kind]:.1%} of what has light")
        if figures["black_things"]:
            self.faults.append(f"{self.name}: things {figures['black_things']} are black")
        figures["speckles"] = self.speckles()
        if figures["speckles"] > MAX_SPECKLES:
            self.faults.append(f"{self.name}: {figures['speckles']:.1%} of the pixels are speckles")
        for modality, frame in self.frames.items():
            if np.isposinf(np.abs(frame.data.astype(np.float64))).any() and modality == "flow":
                self.faults.append(f"{self.name}: {modality} is infinite")
        return figures

    def _holes(self, lowest_m: float) -> int:
        """Return how many rays pass the lowest ground's level inside the stage, and hit none."""
        if "dem" in self.data["stage"] or "mesh" in self.data["stage"]:
            extent_m = 30.0
        else:
            extent_m = float(self.data["stage"]["extent_m"])
        x, y, z = np.moveaxis(self.directions, -1, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (lowest_m - self.origin_m[2]) / z
            there = np.abs(np.stack((x, y)) * t + self.origin_m[:2, None, None]).max(axis=0)
        passes = (z < 0) & (t > 0) & (there < extent_m / 2 - 0.5)
        return int((passes & ~self.is_hit).sum())

    def _black(self, surface: Surface) -> Json:
        """Return which share of what is lit is black in colour, and of the ground in albedo."""
        limit = 0 if self.data["render"].get("view_transform") == "raw" else BLACK
        rgb, albedo = self.frames["rgb"].data, self.frames["albedo"].data
        is_lit = self.is_hit & ~self.is_water & self._light(surface)
        has_albedo = albedo.max(axis=-1) > BLACK_ALBEDO
        judged = is_lit & (has_albedo | self.is_ground)
        black = judged & (rgb.max(axis=-1) <= limit)
        no_albedo = self.is_ground & ~has_albedo
        return {
            "lit": float(is_lit.mean()),
            "black": float(black.sum() / max(judged.sum(), MIN_PIXELS)),
            "black_albedo": float(no_albedo.sum() / max(self.is_ground.sum(), MIN_PIXELS)),
            "black_things": self._without_albedo(has_albedo),
        }

    def _without_albedo(self, has_albedo: Mask) -> list[int]:
        """Return the ids of things that are black; they may be a small share of a picture."""
        ids = self.frames["instance"].data
        numbers, counts = np.unique(ids[self.is_hit & ~self.is_water], return_counts=True)
        seen = set(numbers[(counts >= OBJECT_PIXELS) & (numbers > 0)].tolist())
        return sorted(seen - set(np.unique(ids[has_albedo]).tolist()))

    def _light(self, surface: Surface) -> Mask:
        """Return which pixels sun or sky lights."""
        environment = self.data["environment"]
        has_sky = environment["sky"]["model"] != "none" or "hdri" in environment
        is_day = environment["sun_elevation_deg"] >= LOWEST_SUN_DEG or "hdri" in environment
        if has_sky and is_day:
            return np.ones_like(self.is_hit)
        sky = surface.scene.sky
        lit = np.zeros_like(self.is_hit)
        if sky.lamp_w_m2 <= 0 or not self.is_hit.any():
            return lit
        along = self.rays[..., 2] if not self._is_fisheye else np.ones_like(self.depth_m)
        range_m = self.depth_m / np.where(along > 0, along, 1)
        points = self.origin_m + self.directions * self.depth_m[..., None]
        start = (points - 1e-4 * self.directions * range_m[..., None])[self.is_hit]
        to_sun = np.broadcast_to(np.array(sky.to_sun, np.float64), start.shape)
        seen = surface.cast(start, np.ascontiguousarray(to_sun), FARTHEST_M)
        lit[self.is_hit] = seen.targets[:, 0] == NO_TARGET
        if sky.haze is not None:  # as bright as the sky, which is black here
            clear = np.exp(-np.outer(range_m.ravel(), sky.haze.extinction_per_m))
            lit &= (clear.max(axis=1) > LEAST_CONTRAST).reshape(lit.shape)
        # Borders of shadows, and where light grazes, are not judged.
        is_high = environment["sun_elevation_deg"] >= LOWEST_SUN_DEG
        narrowed = cv2.erode(lit.astype(np.uint8), np.ones((5, 5), np.uint8))
        return np.asarray(narrowed.astype(bool) & is_high, bool)

    @property
    def _is_fisheye(self) -> bool:
        return self.frames["depth"].intrinsics.is_fisheye

    def speckles(self) -> float:
        """Return the share of pixels that stand out from their neighbours, beyond the converged."""
        judged = self.is_hit & ~self._edges()
        if judged.sum() < MIN_PIXELS:
            return 0.0
        found = grains(
            self.frames[RGB].data,
            self.reference[RGB].data,
            [frame.data for frame in self.undenoised],
        )
        return float(found[judged].mean())

    def _edges(self) -> Mask:
        """Return where pixels and their neighbours show several things, blurred ones widely."""
        instance = self.frames["instance"].data.astype(np.float64)
        inverse = np.where(self.is_hit, 1 / np.maximum(self.depth_m, 1e-3), 0.0)
        kernel = np.ones((3, 3), np.uint8)
        edge = cv2.dilate(instance, kernel) != cv2.erode(instance, kernel)
        bend = np.abs(cv2.Laplacian(inverse, cv2.CV_64F))
        edge |= bend > MAX_BEND * cv2.dilate(inverse, kernel)
        is_blurred = {"lens", "shutter_share", "exposure_s"} & self.camera.keys()
        width = 9 if is_blurred else 3
        widened = cv2.dilate(edge.astype(np.uint8), np.ones((width, width), np.uint8))
        return np.asarray(widened, bool)
