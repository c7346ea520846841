"""Depth and labels of samples compared with passes of Cycles of the same world."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.geometry import T_LINK_OPTICAL, pose_to_matrix
from oaisys_core.procedural.terrain.presets import PRESETS
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.targets.ground_target import ground_mesh
from oaisys_core.render.geometry_pass import PoseMemory, geometry_frames
from oaisys_core.scene import PlacedCamera
from oaisys_core.simulation import Simulation
from oaisys_core.types import DEPTH, INSTANCE, SEMANTIC_0, ModuleMetadata, Pose
from tools.bench.cycles_passes import reference_images
from tools.bench.jobs.world import Observer, simulation_of, world_config
from tools.bench.settings import Say, Settings
from tools.bench.worlds.demo_views import random_poses

MODALITIES = (DEPTH, SEMANTIC_0, INSTANCE)
VIEWS, QUICK_PRESETS = 2, 3
JITTER_PX = 0.006
"""Upper bound on the distance of Cycles' rays from their pixels' centres."""
DEPTH_TOLERANCE = 2e-5
"""Relative difference of equal depths, in addition to the effect of the jitter."""
STEP_SHARE = 0.05
"""If depth differs within the jitter by more than this share of its range among a pixel's
neighbours, there is a step; on a smooth surface it would be a hundredth."""
FAR_M = 1e6

Images = dict[str, NDArray[np.generic]]


def shares(settings: Settings, say: Say) -> dict[str, dict[str, list[float]]]:
    """Return, by preset and view, the percentage of equal pixels and the unequal ones off edges."""
    presets = sorted(PRESETS)[: QUICK_PRESETS if settings.quick else None]
    found = {}
    with simulation_of(world_config(settings, {"sensors": {"pose_policy": "allow"}})) as simulation:
        for index, preset in enumerate(presets):
            say(index / len(presets), preset)
            simulation.step_batch(ModuleMetadata(custom={"stage": {"preset": preset}}), seed=1)
            observer = Observer(simulation)
            extent_m = simulation.info().stage_extent_m
            assert extent_m is not None
            poses = random_poses(VIEWS, extent_m, observer.heights_m, seed=index)
            surface = Surface(simulation.scene, ground_mesh(simulation.scene))
            pairs, unequal_off_edges = [], []
            for pose in poses:
                camera, *pair = _both(simulation, observer, pose)
                off_edges = _off_edges(surface, camera, pair[0])
                pairs.append(pair)
                unequal_off_edges.append(float((~_equal(*pair) & off_edges).sum()))
            found[preset] = {
                "equal_percent": [100 * float(_equal(*pair).mean()) for pair in pairs],
                "unequal_off_edges": unequal_off_edges,
            }
    return found


def _both(
    simulation: Simulation, observer: Observer, pose: Pose
) -> tuple[PlacedCamera, Images, Images]:
    """Return a camera, its images in a sample, and its images by Cycles' passes."""
    _, sample = observer.sample(pose, {"quality": "geometry"}, modalities=MODALITIES)
    fast = {frame.modality: frame.data for frame in sample.frames}
    T_map_camera = pose_to_matrix(pose) @ T_LINK_OPTICAL
    camera = PlacedCamera("camera", sample.frames[0].intrinsics, T_map_camera, MODALITIES)
    return camera, fast, reference_images(simulation.scene, camera, MODALITIES)


def _equal(fast: Images, cycles: Images) -> NDArray[np.bool_]:
    """Return (H, W) whether ids are equal, and depth within the tolerance and the jitter."""
    depth_m = _reach(fast[DEPTH])
    error_m = np.abs(_reach(cycles[DEPTH]) - depth_m)
    equal = error_m <= DEPTH_TOLERANCE * depth_m + JITTER_PX * _spread(depth_m)
    for modality in MODALITIES[1:]:
        equal &= fast[modality] == cycles[modality]
    return np.asarray(equal, bool)


def _off_edges(surface: Surface, camera: PlacedCamera, seen: Images) -> NDArray[np.bool_]:
    """Return (H, W) whether all rays within the jitter hit the same.

    The other pixels have an edge at their centre, where two ray casters may differ.
    """
    depth_m = _reach(seen[DEPTH])
    step_m = DEPTH_TOLERANCE * depth_m + STEP_SHARE * _spread(depth_m)
    same = np.ones(depth_m.shape, bool)
    for x, y in product((-1, 0, 1), repeat=2):
        centre = camera.intrinsics
        shifted = replace(
            centre, cx_px=centre.cx_px + x * JITTER_PX, cy_px=centre.cy_px + y * JITTER_PX
        )
        frames = geometry_frames(surface, replace(camera, intrinsics=shifted), PoseMemory())
        same &= np.abs(_reach(frames[DEPTH].data) - depth_m) <= step_m
        for modality in MODALITIES[1:]:
            same &= frames[modality].data == seen[modality]
    return np.asarray(same, bool)


def _reach(depth_m: NDArray[np.generic]) -> NDArray[np.float64]:
    return np.where(np.isfinite(depth_m), depth_m, FAR_M).astype(np.float64)


def _spread(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the range of values among each pixel and its eight neighbours."""
    square = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.dilate(image, square) - cv2.erode(image, square), np.float64)
