"""Times of fusing views and extracting their mesh, compared with Open3D on the same views."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import open3d as o3d

from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import invert, pose_looking_down
from oaisys_core.simulation import Simulation
from oaisys_core.types import DEPTH, RGB, SEMANTIC_0, Frame, ModuleMetadata, merge
from oaisys_grpc.memory import keep_freed_memory
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume
from oaisys_mapping.voxels.block_layout import BLOCK_VOXELS
from oaisys_mapping.voxels.blocks import INITIAL_BLOCKS
from tools.bench.jobs.transport.processes import SMALL_WORLD
from tools.bench.settings import Say, Settings, camera

EXTENT_M = 100.0
COLUMNS, ROWS = 6, 5
ALTITUDE_M = 25.0
"""From here, thirty 640x480 images cover the ground, and neighbours overlap by a tenth."""
MIN_WEIGHT = 0.5

Images = tuple[Frame, Frame, Frame]
"""Depth, colour and labels of one view."""


def fusing(settings: Settings, say: Say) -> dict[str, dict[str, list[float]]]:
    """Return milliseconds of fusing each view, and of the mesh after it, for ours and Open3D.

    Our mesh is updated, Open3D's is extracted anew, so that it is measured a few times only.
    """
    keep_freed_memory()  # as the mapper does
    views = _views(settings, say)
    config = TsdfConfig()
    found: dict[str, dict[str, list[float]]] = {"ours": {}, "open3d": {}}
    volume, plain = TsdfVolume(config), _Open3dVolume(config)
    ways: dict[str, tuple[Callable[[Images], object], Callable[[], object]]] = {
        "ours": (partial(_integrate, volume), volume.extract_mesh),
        "open3d": (plain.integrate, plain.mesh),
    }
    # Warm-up with other volumes: libraries load and allocate on their first call.
    _integrate(TsdfVolume(config), views[0])
    _Open3dVolume(config).integrate(views[0])
    for index, view in enumerate(views):
        say(0.5 + 0.4 * index / len(views), f"fusing {len(views)} views")
        for name, (integrate, mesh) in ways.items():
            found[name].setdefault("integrate_ms", []).append(_ms(partial(integrate, view)))
            if name == "ours":
                found[name].setdefault("mesh_ms", []).append(_ms(mesh))
    found["ours"]["integrate_classes_ms"] = _with_classes(config, views)
    for run in range(settings.runs):
        say(0.9 + 0.1 * run / settings.runs, "meshes")
        found["open3d"].setdefault("mesh_ms", []).append(_ms(plain.mesh))
    found["ours"]["last_mesh_ms"] = [_ms_after(volume, view) for view in views[-settings.runs :]]
    found["ours"]["whole_mesh_ms"] = [_ms_anew(volume) for _ in range(settings.runs)]
    return found


def _views(settings: Settings, say: Say) -> list[Images]:
    """Return images of uneven ground from a grid of poses, by the analytic backend."""
    changes = {"seed": 1, "stage": {"extent_m": EXTENT_M, "resolution_px": 801}}
    sized = merge(SMALL_WORLD, camera(settings.width_px, settings.height_px))
    simulation = Simulation(config_from_mapping(merge(sized, changes)))
    simulation.step_batch()
    views = []
    for index in range(COLUMNS * ROWS):
        say(0.5 * index / (COLUMNS * ROWS), "views of 100 m x 100 m")
        x_m = EXTENT_M * ((index % COLUMNS + 0.5) / COLUMNS - 0.5)
        y_m = EXTENT_M * ((index // COLUMNS + 0.5) / ROWS - 0.5)
        z_m = float(simulation.query_height([(x_m, y_m, 0.0)]).surface_height_m[0])
        pose = pose_looking_down(x_m, y_m, z_m + ALTITUDE_M, np.pi / 2)
        sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))
        depth, color, labels = (sample.frame("camera", name) for name in (DEPTH, RGB, SEMANTIC_0))
        views.append((depth, color, labels))
    simulation.close()
    return views


def _with_classes(config: TsdfConfig, views: list[Images]) -> list[float]:
    """Return milliseconds of fusing each view into a volume with classes."""
    volume = TsdfVolume(replace(config, semantic=True))
    _integrate(volume, views[0])
    return [_ms(partial(_integrate, volume, view)) for view in views]


def _integrate(volume: TsdfVolume, view: Images) -> None:
    depth, color, labels = view
    volume.integrate(
        depth.data,
        color.data,
        depth.intrinsics,
        depth.T_map_camera,
        labels.data if volume.config.semantic else None,
    )


def _ms_after(volume: TsdfVolume, view: Images) -> float:
    """Return milliseconds of updating the whole mesh after one more view."""
    _integrate(volume, view)
    return _ms(volume.extract_mesh)


def _ms_anew(volume: TsdfVolume) -> float:
    """Return milliseconds of extracting the whole mesh anew."""
    volume.forget_mesh()
    return _ms(volume.extract_mesh)


class _Open3dVolume:
    """Open3D's volume with the same voxels, called as in its tutorial."""

    def __init__(self, config: TsdfConfig) -> None:
        kinds = (o3d.core.float32, o3d.core.float32, o3d.core.float32)
        self._config = config
        self._grid = o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight", "color"),
            kinds,
            ((1), (1), (3)),
            config.voxel_size_m,
            BLOCK_VOXELS,
            INITIAL_BLOCKS,
            o3d.core.Device("CPU:0"),
        )

    def integrate(self, view: Images) -> None:
        """Fuse a view."""
        depth, color, _ = view
        shown = o3d.t.geometry.Image(o3d.core.Tensor(np.ascontiguousarray(depth.data)))
        colored = o3d.t.geometry.Image(o3d.core.Tensor(color.data.astype(np.float32) / 255))
        K = o3d.core.Tensor(depth.intrinsics.K)
        T_camera_map = o3d.core.Tensor(invert(depth.T_map_camera))
        far = (1.0, float(self._config.max_range_m), float(self._config.truncation_voxels))
        blocks = self._grid.compute_unique_block_coordinates(shown, K, T_camera_map, *far)
        self._grid.integrate(blocks, shown, colored, K, K, T_camera_map, *far)

    def mesh(self) -> Any:
        """Return the surface."""
        return self._grid.extract_triangle_mesh(MIN_WEIGHT)


def _ms(action: Callable[[], object]) -> float:
    started_s = time.perf_counter()
    action()
    return 1e3 * (time.perf_counter() - started_s)
