"""Small worlds that need no texture or terrain generator, and cameras to look at them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oaisys_core.geometry import T_LINK_OPTICAL, pose_to_matrix, transform
from oaisys_core.scene import (
    HeightField,
    MeshPrototype,
    PbrMaps,
    PlacedCamera,
    Placement,
    Primitive,
    Scene,
    Sky,
    TerrainLayer,
    TerrainMaterial,
)
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import DEPTH, INSTANCE, SEMANTIC_0, FloatArray, PinholeIntrinsics, Pose

EXTENT_M = 40.0
SKY_ID = 7
LABELS = (DEPTH, SEMANTIC_0, INSTANCE)
SMALL_MATERIALS: dict[str, Any] = {
    "texture_size_px": 16,
    "mask": {"size_px": 16, "relief": 0},
}
"""Section of a configuration, for worlds whose ground's look is not judged."""

CENTRED = PinholeIntrinsics(64, 48, 54.0, 54.0, 31.5, 23.5)
SKEWED = PinholeIntrinsics(90, 50, 70.0, 95.0, 37.2, 30.9)
"""Off-centre, with pixels that are not square."""

SPHERE = Primitive(
    "sphere", (1.5, 1.5, 1.5), transform(np.eye(3), (2.0, 1.0, 1.0)), 901, (20,), (0.6, 0.3, 0.2)
)
BOX = Primitive(
    "box",
    (1.0, 2.0, 1.5),
    transform(Rotation.from_euler("xyz", (0.3, 0.2, 0.5)).as_matrix(), (-2.0, -1.0, 1.2)),
    902,
    (21,),
    (0.2, 0.3, 0.7),
)


@dataclass(frozen=True)
class GivenTone:
    """A tone whose (T, T, 3) image is given."""

    pixels: NDArray[np.uint8]


SUNNY = Sky(
    sun_elevation_rad=0.7,
    sun_azimuth_rad=2.0,
    sun_strength_w_m2=4.0,
    sun_angular_diameter_rad=0.0095,
    sky_strength=1.0,
    air=1.0,
    dust=1.0,
    ozone=1.0,
    semantic_ids=(SKY_ID,),
)


def flat_world() -> Scene:
    """A level ground at 0.25 m with a sphere and a box."""
    return _scene(np.full((9, 9), 0.25), rocks=0, primitives=(SPHERE, BOX), stage_hash="flat")


def rocky_world() -> Scene:
    """Rolling, rough ground with lumpy rocks on it."""
    rng = np.random.default_rng(4)
    t = np.linspace(0, 1, 129)
    hills = 1.5 * np.sin(9 * t)[None, :] * np.cos(7 * t)[:, None]
    elevation_m = hills + 0.04 * rng.normal(size=hills.shape)
    return _scene(elevation_m, rocks=80, primitives=(), stage_hash="rocky")


def with_separate_rocks(scene: Scene) -> Scene:
    """Return the scene with placements so small that each instance is an object in Blender."""
    few = 40
    return replace(
        scene,
        placements=tuple(
            replace(
                each,
                T_map_object=each.T_map_object[first : first + few],
                instance_ids=each.instance_ids[first : first + few],
            )
            for each in scene.placements
            for first in range(0, len(each.instance_ids), few)
        ),
    )


def camera(
    pose: Pose, intrinsics: PinholeIntrinsics = CENTRED, modalities: tuple[str, ...] = LABELS
) -> PlacedCamera:
    """A camera whose link frame is at ``pose``."""
    return PlacedCamera("camera", intrinsics, pose_to_matrix(pose) @ T_LINK_OPTICAL, modalities)


def settings(samples: int = 1, exposure_ev: float = 0.0) -> RenderSettings:
    """Quick colour, without denoising."""
    return RenderSettings("test", samples, 2, False, exposure_ev, 0)


def texture(name: str, color: tuple[int, int, int], tile_m: float) -> PbrMaps:
    """A checkered texture."""
    checks = np.indices((16, 16)).sum(axis=0) // 4 % 2
    shade = (0.7 + 0.3 * checks)[..., None]
    return PbrMaps(
        name=name,
        color_srgb=(shade * color).astype(np.uint8),
        height=checks.astype(np.float32),
        normal_gl=np.full((16, 16, 3), (128, 128, 255), dtype=np.uint8),
        roughness=np.full((16, 16), 200, dtype=np.uint8),
        tile_m=tile_m,
    )


def _scene(
    elevation_m: FloatArray, rocks: int, primitives: tuple[Primitive, ...], stage_hash: str
) -> Scene:
    half_m = EXTENT_M / 2
    ground = HeightField(
        elevation_m.astype(np.float32), (-half_m, -half_m), EXTENT_M / (len(elevation_m) - 1)
    )
    t = np.linspace(0, 12, 32)
    share = 0.5 + 0.5 * np.sin(t)[None, :] * np.cos(t)[:, None]
    material = TerrainMaterial(
        layers=(
            TerrainLayer("gravel", (1,), texture("gravel", (120, 100, 80), 2.0)),
            TerrainLayer("sand", (2,), texture("sand", (210, 190, 140), 3.0)),
        ),
        masks=np.stack((share, 1 - share)).astype(np.float32),
        extent_m=ground.extent_m,
    )
    return Scene(
        ground=ground,
        material=material,
        prototypes=(_rock(),) if rocks else (),
        placements=(_placement(ground, rocks),) if rocks else (),
        primitives=primitives,
        sky=SUNNY,
        semantic_labels={1: "gravel", 2: "sand", 10: "rock", 20: "sphere", 21: "box"},
        stage_hash=stage_hash,
    )


def _rock() -> MeshPrototype:
    """A lumpy ball: an octahedron, divided four times."""
    corners = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, 0, -1)])
    faces = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
    triangles = corners[np.array(faces)].astype(np.float64)
    for _ in range(4):
        a, b, c = np.moveaxis(triangles, 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    points, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    x, y, z = points.T
    points *= (1 + 0.2 * np.sin(3 * x + 2 * y) * np.cos(4 * z))[:, None] * (1.0, 0.8, 0.6)
    return MeshPrototype(
        "rock",
        points.astype(np.float32),
        index.reshape(-1, 3).astype(np.int32),
        texture("rock", (130, 120, 115), 1.0),
    )


def _placement(ground: HeightField, count: int) -> Placement:
    rng = np.random.default_rng(8)
    xy_m = rng.uniform(-9, 9, (count, 2))
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(rng.normal(size=(count, 3))).as_matrix()
    T[:, :3, :3] *= rng.uniform(0.2, 0.8, (count, 1, 1))
    T[:, :2, 3] = xy_m
    T[:, 2, 3] = ground.height_at(xy_m)
    return Placement(0, (10,), T, np.arange(1, count + 1, dtype=np.uint32))
