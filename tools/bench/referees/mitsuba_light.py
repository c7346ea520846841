"""Mitsuba 3 renders the radiance of a mesh; a program of its own: ``mitsuba_light FOLDER``.

FOLDER has ``scene.json`` (see `Lighting`), ``ground.ply`` and, if there are any, ``objects.ply``.
It gets ``light.npz`` with (H, W) images: ``radiance``, ``depth_m``, ``is_object``, and
``sun_share``, the share of points of the sun's disc that the point in the pixel's middle sees.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from math import acos, cos, pi, sin
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from oaisys_core.scene.photometric_laws import Hapke
from oaisys_core.types import FloatArray
from oaisys_core.verification.light.photometric_forms import radiance_factor
from tools.bench.referees.lighting import GROUND, OBJECTS, Lighting

SKY_ROWS = 512
RIM_POINTS = 8
Reflectance = Callable[[float, float, float], float]
"""The radiance factor by the angles of incidence, emergence and phase, in radians."""


def main() -> None:
    """Render the scene of the folder that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    mi.set_variant("scalar_rgb")
    lighting = Lighting(**json.loads((folder / "scene.json").read_text()))
    mi.register_bsdf("law", _law_bsdf(_reflectance(lighting)))
    # Optimised, meshes of the same look become one.
    scene = mi.load_dict(_scene(lighting, folder), optimize=False)
    image = np.array(mi.render(scene, spp=lighting.samples, seed=1))[..., :3].mean(axis=-1)
    np.savez(folder / "light.npz", radiance=image, **_first_hits(scene, lighting))


def _reflectance(lighting: Lighting) -> Reflectance:
    law = None if lighting.hapke is None else Hapke(**lighting.hapke)
    if law is None:
        return lambda i, _e, _g: lighting.albedo * cos(i)
    return lambda i, e, g: radiance_factor(lighting.albedo, law, i, e, g)


def _law_bsdf(factor: Reflectance) -> type:
    """Return a class of Mitsuba's that reflects by a law; it samples by the cosine."""

    class Law(mi.BSDF):  # type: ignore[misc, unused-ignore]
        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
            self.m_components = [self.m_flags]

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            out = mi.BSDFSample3f()
            out.wo = mi.warp.square_to_cosine_hemisphere(sample2)
            out.pdf = mi.warp.square_to_cosine_hemisphere_pdf(out.wo)
            out.eta = 1.0
            out.sampled_type = +mi.BSDFFlags.DiffuseReflection
            out.sampled_component = 0
            weight = self.eval(ctx, si, out.wo, active) / out.pdf if out.pdf > 0 else mi.Color3f(0)
            return out, weight

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            if wo.z <= 0 or si.wi.z <= 0:
                return mi.Color3f(0.0)
            phase = acos(max(-1.0, min(1.0, wo.x * si.wi.x + wo.y * si.wi.y + wo.z * si.wi.z)))
            return mi.Color3f(factor(acos(min(1.0, wo.z)), acos(min(1.0, si.wi.z)), phase) / pi)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return mi.warp.square_to_cosine_hemisphere_pdf(wo) if si.wi.z > 0 else 0.0

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    return Law


def _scene(lighting: Lighting, folder: Path) -> dict[str, Any]:
    lambert = {
        "type": "diffuse",
        "reflectance": {"type": "rgb", "value": [lighting.albedo] * 3},
    }
    ground = lambert if lighting.hapke is None else {"type": "law"}
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": lighting.max_bounces + 2, "rr_depth": 100},
        "sensor": _sensor(lighting),
        "ground": {"type": "ply", "filename": str(folder / GROUND), "bsdf": ground},
        "sun": {
            "type": "directional",
            "direction": [-each for each in lighting.to_sun],
            "irradiance": {"type": "rgb", "value": [lighting.sun_w_m2] * 3},
        },
    }
    if (folder / OBJECTS).is_file():
        scene["objects"] = {"type": "ply", "filename": str(folder / OBJECTS), "bsdf": lambert}
    if lighting.zenith or lighting.horizon:
        scene["sky"] = _sky(lighting)
    return scene


def _sensor(lighting: Lighting) -> dict[str, Any]:
    width_px, height_px = lighting.size_px
    # Mitsuba's cameras look along z, too, but have x to the left and y up.
    pose = np.array(lighting.T_map_camera) @ np.diag((-1.0, -1.0, 1.0, 1.0))
    half_tan = width_px / 2 / lighting.K[0][0]
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(half_tan))),
        "near_clip": 0.01,
        "far_clip": 10_000.0,
        "to_world": mi.ScalarTransform4f(pose.tolist()),
        "film": {
            "type": "hdrfilm",
            "width": width_px,
            "height": height_px,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
        },
        "sampler": {"type": "multijitter", "sample_count": lighting.samples},
    }


def _sky(lighting: Lighting) -> dict[str, Any]:
    """Return the sky as an image; its rows go from the zenith down, about Mitsuba's y."""
    elevation_rad = pi / 2 - (np.arange(SKY_ROWS) + 0.5) / SKY_ROWS * pi
    share = np.sqrt(np.maximum(np.sin(elevation_rad), 0.0))
    rows = lighting.horizon + (lighting.zenith - lighting.horizon) * share
    image = np.broadcast_to(rows[:, None, None], (SKY_ROWS, 8, 3)).astype(np.float32)
    turned = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
    bitmap = mi.Bitmap(np.ascontiguousarray(image))
    return {"type": "envmap", "bitmap": bitmap, "to_world": turned}


def _first_hits(scene: Any, lighting: Lighting) -> dict[str, FloatArray]:
    """Return what rays through the pixels' middles hit, and how much of the sun is seen there."""
    width_px, height_px = lighting.size_px
    depth_m = np.full((height_px, width_px), np.inf)
    is_object, sun_share = np.zeros_like(depth_m), np.zeros_like(depth_m)
    suns = [mi.Vector3f(*each) for each in _sun_points(lighting)]
    T, K = np.array(lighting.T_map_camera), np.array(lighting.K)
    for row, column in np.ndindex(height_px, width_px):
        ray = np.linalg.inv(K) @ (column, row, 1.0)
        direction = T[:3, :3] @ ray / np.linalg.norm(ray)
        si = scene.ray_intersect(mi.Ray3f(mi.Point3f(*T[:3, 3]), mi.Vector3f(*direction)))
        if not si.is_valid():
            continue
        depth_m[row, column] = si.t / np.linalg.norm(ray)
        is_object[row, column] = si.shape.id() == "objects"
        seen = [not scene.ray_test(si.spawn_ray(sun)) and _dot(si.n, sun) > 0 for sun in suns]
        sun_share[row, column] = np.mean(seen)
    return {"depth_m": depth_m, "is_object": is_object, "sun_share": sun_share}


def _sun_points(lighting: Lighting) -> FloatArray:
    """Return the (N, 3) directions of the middle of the sun and of points of its rim."""
    to_sun = np.array(lighting.to_sun)
    aside = np.cross(to_sun, (0.0, 0.0, 1.0) if abs(to_sun[2]) < 0.9 else (1.0, 0.0, 0.0))
    aside /= np.linalg.norm(aside)
    across = np.cross(to_sun, aside)
    angles = np.arange(RIM_POINTS) * 2 * pi / RIM_POINTS
    rim = cos(lighting.sun_radius_rad) * to_sun + sin(lighting.sun_radius_rad) * (
        np.cos(angles)[:, None] * aside + np.sin(angles)[:, None] * across
    )
    return np.concatenate((to_sun[None], rim))


def _dot(first: Any, second: Any) -> float:
    return float(first.x * second.x + first.y * second.y + first.z * second.z)


if __name__ == "__main__":
    main()
