"""Scans of Blender's backend: closed forms, the analytic backend's scans, the depth images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blender_process import in_blender
from synthetic_worlds import CENTRED, SPHERE, camera, flat_world, rocky_world

from oaisys_core.color import linear
from oaisys_core.config.sections.sensing.lidars import RotatingScanConfig
from oaisys_core.geometry import pixel_rays, pose_looking_at, pose_looking_down, transform
from oaisys_core.procedural.lidar_patterns import rotating
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.scene import PlacedCamera, PlacedLidar, ScanPattern, Scene
from oaisys_core.scene.terrain_material import Variation
from oaisys_core.sensing.faults import CaptureId
from oaisys_core.types import FloatArray, LidarScan

pytestmark = pytest.mark.blender

GROUND_M = 0.25
EYE = transform(((0.8, -0.6, 0.0), (0.6, 0.8, 0.0), (0.0, 0.0, 1.0)), (0.5, -1.0, 3.0))
TOLERANCE_M = 1e-3


def lidar(name: str, pattern: ScanPattern, T_map_lidar: FloatArray = EYE) -> PlacedLidar:
    fields = ("label", "instance")
    return PlacedLidar(name, pattern, T_map_lidar, 0.0, 60.0, 10.0, extra_fields=fields)


def turning() -> PlacedLidar:
    scan = RotatingScanConfig(channels=32, azimuth_steps=256, elevation_min_deg=-60)
    return lidar("turning", rotating(scan, 0.1))


def view() -> PlacedCamera:
    pose = pose_looking_at((-3.0, 2.0, 4.0), (0.0, 0.0, 0.5))
    return camera(pose, CENTRED, ("range", "semantic_0", "instance"))


def through_pixels(placed: PlacedCamera) -> PlacedLidar:
    """A lidar in a camera's optical frame, with a ray through each pixel's centre."""
    rays = pixel_rays(placed.intrinsics).reshape(-1, 3)
    directions = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    count = len(directions)
    pattern = ScanPattern(directions, np.arange(count) / count, np.zeros(count, np.uint16))
    return lidar("pixels", pattern, placed.T_map_camera)


def analytic(scene: Scene, placed: PlacedLidar) -> LidarScan:
    backend = AnalyticBackend()
    backend.build(scene, lambda _: None)
    return backend.scan(placed, CaptureId(1, 1, placed.name))


def assert_same(found: LidarScan, expected: LidarScan) -> None:
    """The same rays return, from the same points, but for a few at edges."""
    scans = (found.data, expected.data)
    keys = [list(zip(s["time"].tolist(), s["ring"].tolist(), strict=True)) for s in scans]
    both = set(keys[0]) & set(keys[1])
    assert len(both) > 0.999 * max(map(len, keys))
    a, b = (s[[key in both for key in of]] for s, of in zip(scans, keys, strict=True))
    apart_m = np.linalg.norm([a[axis] - b[axis] for axis in "xyz"], axis=0)
    near = apart_m < TOLERANCE_M
    assert near.mean() > 0.999
    for name in ("label", "instance"):
        assert (a[name] == b[name])[near].mean() > 0.999
    assert np.median(np.abs(a["intensity"] - b["intensity"])[near]) < 1e-3


def test_ranges_are_those_of_a_plane_and_a_sphere_and_of_the_depth_image() -> None:
    scene = replace(flat_world(), primitives=(SPHERE,))
    placed = turning()
    (scan, pixels), frames, again, _ = in_blender(
        "sensors.scans", scene, [placed, through_pixels(view())], [view()]
    )
    points_m = scan.points_m @ EYE[:3, :3].T + EYE[:3, 3]
    on_sphere = scan.data["instance"] == SPHERE.instance_id
    centre_m, radius_m = SPHERE.T_map_object[:3, 3], SPHERE.size_m[0]
    assert on_sphere.sum() > 50
    away_m = np.linalg.norm(points_m[on_sphere] - centre_m, axis=1) - radius_m
    assert np.abs(away_m).max() < TOLERANCE_M
    assert (~on_sphere).sum() > 1000
    assert np.abs(points_m[~on_sphere, 2] - GROUND_M).max() < TOLERANCE_M
    assert_same(scan, analytic(scene, placed))

    range_m, label, instance = (frame.data for frame in frames)
    seen = np.isfinite(range_m) & (range_m <= 60)
    assert len(pixels.data) == seen.sum() > 1000
    found_m = np.linalg.norm(pixels.points_m, axis=1)
    assert np.abs(found_m - range_m[seen]).max() < TOLERANCE_M
    np.testing.assert_array_equal(pixels.data["label"], label[seen])
    np.testing.assert_array_equal(pixels.data["instance"], instance[seen])
    assert again.data.tobytes() == pixels.data.tobytes()


@pytest.mark.long
def test_both_backends_return_the_same_points_of_rough_ground_with_rocks() -> None:
    scene = rocky_world()
    placed = turning()
    (scan, pixels), frames, _, _ = in_blender(
        "sensors.scans", scene, [placed, through_pixels(view())], [view()]
    )
    assert len(scan.data) > 2000
    assert (scan.data["instance"] > 0).sum() > 20
    assert_same(scan, analytic(scene, placed))
    range_m = frames[0].data
    seen = np.isfinite(range_m) & (range_m <= 60)
    assert len(pixels.data) == seen.sum()
    found_m = np.linalg.norm(pixels.points_m, axis=1)
    assert np.abs(found_m - range_m[seen]).max() < TOLERANCE_M


@pytest.mark.long
def test_intensity_shows_the_texture_that_blender_renders() -> None:
    world = flat_world()
    even = replace(world.material, variation=Variation(brightness=0.0))
    scene = replace(world, primitives=(), material=even)
    down = camera(pose_looking_down(1.0, -2.0, 5.0), CENTRED, ("albedo",))
    placed = replace(through_pixels(down), reference_range_m=100.0)
    (scan,), (albedo,), _, _ = in_blender("sensors.scans", scene, [placed], [down])
    rays = -pixel_rays(CENTRED).reshape(-1, 3)
    cosines = 1 / np.linalg.norm(rays, axis=1)
    reflectance = scan.data["intensity"] / 255 / cosines
    seen = linear(albedo.data / 255).mean(axis=-1).ravel()
    assert len(reflectance) == len(seen)
    assert np.ptp(reflectance) > 0.1
    # Blender interpolates between texels.
    assert np.corrcoef(reflectance, seen)[0, 1] > 0.9
    assert abs(np.median(reflectance / seen) - 1) < 0.02


@pytest.mark.long
def test_64_channels_of_1024_steps_take_a_tenth_of_a_second_of_processor_time() -> None:
    placed = lidar("lidar", rotating(RotatingScanConfig(preset="generic_64"), 0.1))
    _, _, scan, seconds = in_blender("sensors.scans", rocky_world(), [placed], [])
    assert len(scan.data) > 30_000
    load_factor = 3
    assert seconds < 0.1 * load_factor
