"""Depth and labels of samples against passes that Cycles renders of the same world."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.blender.reference import reference_images
from oaisys_core.geometry import T_LINK_OPTICAL, pose_to_matrix
from oaisys_core.scene import PlacedCamera
from oaisys_core.simulation import Simulation
from oaisys_core.terrain.presets import PRESETS
from oaisys_core.types import DEPTH, INSTANCE, SEMANTIC_0, ModuleMetadata, Pose
from tools.bench.jobs.world import Observer, simulation_of, world_config
from tools.bench.settings import Say, Settings
from tools.bench.views import random_poses

MODALITIES = (DEPTH, SEMANTIC_0, INSTANCE)
VIEWS, QUICK_PRESETS = 2, 3
JITTER_PX = 0.006
"""Greatest distance of Cycles' rays from their pixels' centres, and a bit."""
DEPTH_TOLERANCE = 2e-5
"""Relative, beside what the jitter does."""
STEP = 0.1
"""Relative difference of depth between neighbours that is an edge."""
BEND = 0.005
"""Relative difference of inverse depth from the mean of its neighbours' on two sides that is an
edge: it is none on a plane, however steep, so that low crests and rims are found, too."""
FAR_M = 1e6

Images = dict[str, NDArray[np.generic]]


def shares(settings: Settings, say: Say) -> dict[str, dict[str, list[float]]]:
    """Return, by preset of terrain, equal pixels in percent and unequal ones off edges, by view."""
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
            pairs = [_both(simulation, observer, pose) for pose in poses]
            found[preset] = {
                "equal_percent": [100 * float(_equal(*pair).mean()) for pair in pairs],
                "unequal_off_edges": [
                    float((~_equal(*pair) & _off_edges(pair[0])).sum()) for pair in pairs
                ],
            }
    return found


def _both(simulation: Simulation, observer: Observer, pose: Pose) -> tuple[Images, Images]:
    """Return a view as a sample gives it, and as Cycles' passes show it."""
    _, sample = observer.sample(pose, {"quality": "geometry"}, modalities=MODALITIES)
    fast = {frame.modality: frame.data for frame in sample.frames}
    T_map_camera = pose_to_matrix(pose) @ T_LINK_OPTICAL
    camera = PlacedCamera("camera", sample.frames[0].intrinsics, T_map_camera, MODALITIES)
    return fast, reference_images(simulation.scene, camera, MODALITIES)


def _equal(fast: Images, cycles: Images) -> NDArray[np.bool_]:
    """Return the (H, W) pixels whose ids are the same, and whose depth is but for the jitter."""
    depth_m = _reached(fast[DEPTH])
    error_m = np.abs(_reached(cycles[DEPTH]) - depth_m)
    equal = error_m <= DEPTH_TOLERANCE * depth_m + JITTER_PX * _spread(depth_m)
    for modality in MODALITIES[1:]:
        equal &= fast[modality] == cycles[modality]
    return np.asarray(equal, bool)


def _off_edges(images: Images) -> NDArray[np.bool_]:
    """Return the (H, W) pixels whose neighbours are of the same thing, without a step or bend."""
    depth_m = _reached(images[DEPTH])
    inside = (_spread(depth_m) < STEP * depth_m) & (_bend(depth_m) < BEND)
    for modality in MODALITIES[1:]:
        inside &= _spread(images[modality].astype(np.float64)) == 0
    return np.asarray(inside, bool)


def _reached(depth_m: NDArray[np.generic]) -> NDArray[np.float64]:
    return np.where(np.isfinite(depth_m), depth_m, FAR_M).astype(np.float64)


def _bend(depth_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far each pixel lies off a line through its neighbours, along rows or columns."""
    inverse = np.pad(1 / depth_m, 1, mode="reflect", reflect_type="odd")
    middle = inverse[1:-1, 1:-1]
    along = inverse[1:-1, :-2] + inverse[1:-1, 2:] - 2 * middle
    across = inverse[:-2, 1:-1] + inverse[2:, 1:-1] - 2 * middle
    return np.asarray(np.maximum(np.abs(along), np.abs(across)) / (2 * middle))


def _spread(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the greatest less the least value of each pixel and its eight neighbours."""
    square = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.dilate(image, square) - cv2.erode(image, square), np.float64)
