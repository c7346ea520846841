"""Radiance of small worlds by our renderers, and by Mitsuba on their true meshes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from math import cos, radians, sin
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

# Must come before anything that loads Open3D, see oaisys_core.private.open3d_import.
import bpy  # noqa: F401
import numpy as np
import trimesh

from oaisys_core.config import config_from_mapping
from oaisys_core.render import make_backend
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.scene.photometric_laws import Hapke
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.simulation import Simulation
from oaisys_core.types import FloatArray, TriangleMesh
from oaisys_core.verification.light.scenes import GreyPlane, camera, grey_sky, world
from tools.bench.jobs.light_errors import errors
from tools.bench.referees.lighting import GROUND, OBJECTS, Lighting
from tools.bench.referees.module_process import run_module
from tools.bench.settings import Say, Settings

SIZE_PX = (128, 96)
FOCAL_SHARE = 1.125
"""Focal length relative to the image's width."""
SUN_DIAMETER_DEG = 0.53
SUN_W_M2 = 4.0
GREY = GreyPlane().grey
SAMPLES = {"blender": 256, "analytic": 1}
REFEREE_SAMPLES = 64


@dataclass(frozen=True)
class LightWorld:
    """A small world of one grey, and its light.

    Attributes:
        config: What its ground and its objects are drawn from.
        sun_elevation_deg, sun_azimuth_deg: Of the sun.
        sky: Radiance at the zenith and at the horizon.
        law: Hapke's, or None for Lambert's.
        max_bounces: Of the light.
        size_px: Of the image. Mitsuba calls our law of Hapke in Python, a hundred times slower
            than its own.
    """

    config: Mapping[str, Any]
    sun_elevation_deg: float
    sun_azimuth_deg: float
    sky: tuple[float, float] = (0.0, 0.0)
    law: Hapke | None = None
    max_bounces: int = 4
    size_px: tuple[int, int] = SIZE_PX


def _stage(preset: str, **assets: Any) -> dict[str, Any]:
    stage = {"preset": preset, "extent_m": 24.0, "resolution_px": 129}
    return {"stage": stage, "assets": {"rocks": [], **assets}}


HAPKE = Hapke(0.32, 0.24, 0.30, 1.8, 0.071, radians(23.4))
ROCKS = [{"kind": "angular", "count": [12, 12], "size_m": [1.0, 2.0]}]
WORLDS = {
    "craters": LightWorld(_stage("craters"), 35.0, 60.0),
    "rocks": LightWorld(_stage("mounds", rocks=ROCKS), 50.0, 200.0, sky=(1.0, 0.4)),
    "hapke": LightWorld(_stage("canyon"), 40.0, 130.0, law=HAPKE, max_bounces=0, size_px=(64, 48)),
    "hapke_bounces": LightWorld(_stage("canyon"), 40.0, 130.0, law=HAPKE, size_px=(64, 48)),
}


def compare(
    settings: Settings, say: Say, world: str, backend: str, quality: str, factor: float = 1.0
) -> dict[str, float]:
    """Return how a renderer's radiance of one of `WORLDS` differs from Mitsuba's.

    Args:
        settings: Of the run.
        say: Called with the progress.
        world: Which one.
        backend, quality: Of the renderer.
        factor: On the image's sides.

    Returns:
        ``mean``: relative error of the mean, ``p95``: 95th percentile of the relative errors, both
        of the pixels that are judged, and their ``share``; ``sun_p95``: the percentile of those in
        the sun.
    """
    del settings
    chosen = WORLDS[world]
    width_px, height_px = (round(factor * each) for each in chosen.size_px)
    chosen = replace(chosen, size_px=(width_px, height_px))
    view = _view(chosen.size_px)
    say(0.1, f"{world}: {backend}")
    scene = _scene(chosen)
    ours, mesh = _rendered(scene, view, chosen, backend, quality)
    say(0.5, f"{world}: Mitsuba")
    theirs = _referee(chosen, mesh, view)
    return errors(ours, theirs)


def _scene(chosen: LightWorld) -> Scene:
    """Return the ground and the objects of a configuration in one grey, under its light."""
    config = config_from_mapping({"backend": "analytic", **chosen.config}, Path())
    simulation = Simulation(config, AnalyticBackend())
    try:
        simulation.step_batch()
        drawn = simulation.scene
    finally:
        simulation.close()
    zenith, horizon = chosen.sky
    sky = replace(
        grey_sky(zenith, horizon),
        model="plain" if zenith or horizon else "none",
        sun_elevation_rad=radians(chosen.sun_elevation_deg),
        sun_azimuth_rad=radians(chosen.sun_azimuth_deg),
        sun_strength_w_m2=SUN_W_M2,
        sun_angular_diameter_rad=radians(SUN_DIAMETER_DEG),
    )
    plain = world(GreyPlane(law=chosen.law), sky)
    prototypes = tuple(
        replace(each, maps=None, vertex_colors_srgb=None, color_srgb=(GREY / 255,) * 3, dust_m=0.0)
        for each in drawn.prototypes
    )
    return replace(
        plain,
        ground=drawn.ground,
        prototypes=prototypes,
        placements=drawn.placements,
        stage_hash=drawn.stage_hash,
    )


def _view(size_px: tuple[int, int]) -> PlacedCamera:
    return camera((-11.0, -9.0, 9.0), (1.0, 1.0, 0.0), size_px, FOCAL_SHARE * size_px[0])


def _rendered(
    scene: Scene, view: PlacedCamera, chosen: LightWorld, backend_name: str, quality: str
) -> tuple[FloatArray, TriangleMesh]:
    """Return the (H, W) radiance by a backend, and the true mesh."""
    backend = make_backend(backend_name)
    try:
        backend.build(scene, lambda _: None)
        settings = RenderSettings(
            quality, SAMPLES[backend_name], chosen.max_bounces, False, 0.0, seed=1
        )
        (frame,) = backend.render_all([view], settings, lambda _: None)
        return frame.data.astype(np.float64).mean(axis=-1), backend.ground_truth_mesh()
    finally:
        backend.close()


def _referee(chosen: LightWorld, mesh: TriangleMesh, view: PlacedCamera) -> dict[str, FloatArray]:
    """Return what Mitsuba finds, see `tools.bench.referees.mitsuba_light`."""
    elevation, azimuth = radians(chosen.sun_elevation_deg), radians(chosen.sun_azimuth_deg)
    lighting = Lighting(
        albedo=GreyPlane().albedo,
        hapke=None if chosen.law is None else asdict(chosen.law),
        to_sun=(cos(elevation) * cos(azimuth), cos(elevation) * sin(azimuth), sin(elevation)),
        sun_w_m2=SUN_W_M2,
        sun_radius_rad=radians(SUN_DIAMETER_DEG / 2),
        zenith=chosen.sky[0],
        horizon=chosen.sky[1],
        max_bounces=chosen.max_bounces,
        samples=REFEREE_SAMPLES,
        K=view.intrinsics.K.tolist(),
        size_px=chosen.size_px,
        T_map_camera=view.T_map_camera.tolist(),
    )
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scene.json").write_text(json.dumps(asdict(lighting)))
        _write_meshes(mesh, folder)
        run_module("tools.bench.referees.mitsuba_light", name)
        with np.load(folder / "light.npz") as found:
            return dict(found)


def _write_meshes(mesh: TriangleMesh, folder: Path) -> None:
    """Write ground and objects; Mitsuba makes normals of vertices, as they have none."""
    assert mesh.instance_ids is not None
    for name, chosen in ((GROUND, mesh.instance_ids == 0), (OBJECTS, mesh.instance_ids > 0)):
        used, corners = np.unique(mesh.triangles[chosen], return_inverse=True)
        if used.size:
            part = trimesh.Trimesh(mesh.vertices_m[used], corners.reshape(-1, 3), process=False)
            part.export(folder / name, vertex_normal=False)
