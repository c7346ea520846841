"""Scans of lidars against closed forms: ranges, times, intensity, errors, second returns."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from synthetic_worlds import BOX, SPHERE, flat_world, rocky_world

from oaisys_core.color import linear
from oaisys_core.config.sections.sensing.lidars import RotatingScanConfig
from oaisys_core.geometry import transform
from oaisys_core.procedural.lidar_patterns import rotating
from oaisys_core.procedural.terrain.macro_variation import MacroPattern
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.targets.ground_target import ground_mesh
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.render.lidar import beam, rays_in_map
from oaisys_core.render.shading.reflectance import Reflectance
from oaisys_core.scene import LidarErrors, PlacedLidar, ScanPattern, Scene
from oaisys_core.scene.photometric_laws import LommelSeeliger
from oaisys_core.sensing.faults import CaptureId
from oaisys_core.types import FloatArray, LidarScan
from oaisys_core.world.modules.lidars import ConstantVelocity

CAPTURE = CaptureId(1, 1, "lidar")
GROUND_M, HALF_M = 0.25, 20.0
"""Height and half edge of `flat_world`'s ground."""

TURNED = transform(
    ((0.8, -0.6, 0.0), (0.6, 0.8, 0.0), (0.0, 0.0, 1.0)),
    (0.5, -1.0, 3.0),
)


def lidar(T_map_lidar: FloatArray = TURNED, **changes: object) -> PlacedLidar:
    scan = RotatingScanConfig(channels=16, azimuth_steps=180, elevation_min_deg=-60)
    placed = PlacedLidar("lidar", rotating(scan, 0.1), T_map_lidar, 0.0, 100.0, 10.0)
    return replace(placed, **changes)  # type: ignore[arg-type]


def scanned(scene: Scene, placed: PlacedLidar, capture: CaptureId = CAPTURE) -> LidarScan:
    backend = AnalyticBackend()
    backend.build(scene, lambda _: None)
    return backend.scan(placed, capture)


def plain() -> Scene:
    return replace(flat_world(), primitives=())


def looking_at(target_m: FloatArray, distance_m: float) -> PlacedLidar:
    """A lidar whose x axis looks at a point from above, with a narrow fan of rays."""
    fan = RotatingScanConfig(
        channels=11,
        azimuth_steps=11,
        elevation_min_deg=-2,
        elevation_max_deg=2,
        azimuth_min_deg=-2,
        azimuth_max_deg=2,
    )
    down = transform(
        ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)),
        target_m + np.array((0, 0, distance_m)),
    )
    return lidar(down, pattern=rotating(fan, 0.1))


def ranges_m(scan: LidarScan) -> FloatArray:
    return np.asarray(np.linalg.norm(scan.points_m, axis=1))


def test_ranges_to_a_plane_and_the_rays_that_miss_it() -> None:
    placed = lidar()
    origins, directions = rays_in_map(placed, placed.pattern.directions)
    with np.errstate(divide="ignore"):
        expected_m = (GROUND_M - origins[2]) / directions[:, 2]
    with np.errstate(invalid="ignore"):
        xy = origins[:2] + expected_m[:, None] * directions[:, :2]
    seen = (expected_m > 0) & (np.abs(xy) <= HALF_M).all(axis=1)

    scan = scanned(plain(), placed)

    assert 500 < seen.sum() < len(seen)
    assert len(scan.data) == seen.sum()
    assert np.abs(ranges_m(scan) - expected_m[seen]).max() < 1e-3
    np.testing.assert_array_equal(scan.data["ring"], placed.pattern.rings[seen])
    np.testing.assert_allclose(scan.data["time"], placed.pattern.times_s[seen], atol=1e-8)


def test_ranges_to_a_sphere() -> None:
    scene = replace(flat_world(), primitives=(SPHERE,))
    placed = lidar(extra_fields=("label", "instance"))
    scan = scanned(scene, placed)
    on_sphere = scan.data["instance"] == SPHERE.instance_id
    centre_m, radius_m = SPHERE.T_map_object[:3, 3], SPHERE.size_m[0]
    points_m = scan.points_m[on_sphere] @ TURNED[:3, :3].T + TURNED[:3, 3]
    assert on_sphere.sum() > 50
    assert np.abs(np.linalg.norm(points_m - centre_m, axis=1) - radius_m).max() < 1e-3
    # The near side only.
    assert (((points_m - centre_m) * (TURNED[:3, 3] - centre_m)).sum(axis=1) > 0).all()
    assert set(scan.data["label"][on_sphere]) == {20}
    assert set(scan.data["label"][~on_sphere]) <= {1, 2}


def test_each_ray_is_cast_from_the_pose_at_its_own_time() -> None:
    motion = ConstantVelocity(TURNED, np.array((2.0, 0.0, -5.0)), np.array((0.2, -0.1, 4.0)))
    placed = lidar(pose_at=motion)
    poses = motion(placed.pattern.times_s)
    directions = np.einsum("nij,nj->ni", poses[:, :3, :3], placed.pattern.directions)
    with np.errstate(divide="ignore"):
        expected_m = (GROUND_M - poses[:, 2, 3]) / directions[:, 2]
    with np.errstate(invalid="ignore"):
        xy = poses[:, :2, 3] + expected_m[:, None] * directions[:, :2]
    seen = (expected_m > 0) & (np.abs(xy) <= HALF_M).all(axis=1) & (expected_m < 100)

    moving, still = scanned(plain(), placed), scanned(plain(), lidar())

    assert len(moving.data) == seen.sum()
    assert np.abs(ranges_m(moving) - expected_m[seen]).max() < 1e-3
    # It sinks by half a metre within the scan.
    assert ranges_m(moving)[-16:].min() < ranges_m(still)[-16:].min() - 0.3
    # The points are in the frame of their own time: taken back to the map, they are on the plane.
    own = poses[seen]
    in_map_m = np.einsum("nij,nj->ni", own[:, :3, :3], moving.points_m) + own[:, :3, 3]
    assert np.abs(in_map_m[:, 2] - GROUND_M).max() < 1e-3


def test_rays_with_origins_of_their_own_hit_what_a_still_lidar_hits_there() -> None:
    scene = rocky_world()
    scene = replace(scene, sky=replace(scene.sky, ground_semantic_ids=(9,)))
    surface = Surface(scene, ground_mesh(scene))
    placed = lidar()
    origin_m, directions = rays_in_map(placed, placed.pattern.directions)
    together = surface.cast(origin_m, directions, 80.0)
    each = surface.cast(np.tile(origin_m, (len(directions), 1)), directions, 80.0)
    assert together.is_hit.sum() > 1000
    assert (together.instance_ids > 0).any()
    np.testing.assert_array_equal(each.depth_m, together.depth_m)
    np.testing.assert_array_equal(each.instance_ids, together.instance_ids)


def test_intensity_follows_the_lidar_equation() -> None:
    scene = replace(flat_world(), primitives=(SPHERE,))
    top_m = SPHERE.T_map_object[:3, 3] + (0, 0, SPHERE.size_m[0])
    albedo = linear(SPHERE.color_srgb).mean()
    near, far = (scanned(scene, looking_at(top_m, distance)) for distance in (5.0, 20.0))
    assert near.data["intensity"].max() == pytest.approx(255 * albedo, rel=2e-3)
    assert far.data["intensity"].max() == pytest.approx(255 * albedo / 4, rel=2e-3)
    # Lambert: by the cosine between the ray and the ground's normal.
    placed = lidar(reference_range_m=1000.0)
    ground = scanned(plain(), placed)
    cosines = -(ground.points_m[:, 2] / ranges_m(ground))
    ratios = ground.data["intensity"] / cosines
    sand, gravel = (linear(np.array(c) / 255).mean() for c in ((210, 190, 140), (120, 100, 80)))
    assert 0.4 * 255 * gravel < ratios.min() <= ratios.max() < 1.0001 * 255 * sand
    fan = looking_at(np.array((0.0, 0.0, GROUND_M)), 4.0)
    assert np.ptp(scanned(plain(), fan).data["ring"]) > 0


def reflectances(scene: Scene) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """Return points of a scan, reflectances by their intensity, and those of all layers there."""
    scan = scanned(scene, lidar(reference_range_m=1000.0))
    xy_m = (scan.points_m @ TURNED[:3, :3].T + TURNED[:3, 3])[:, :2]
    texels = []
    for layer in scene.material.layers:
        u, v = (xy_m / layer.maps.tile_m % 1).T
        image = linear(layer.maps.color_srgb / 255).mean(axis=-1)
        texels.append(image[np.floor((1 - v) * 16).astype(int) % 16, (u * 16).astype(int)])
    return xy_m, scan.data["intensity"] / 255 * ranges_m(scan) / -scan.points_m[:, 2], texels


def of_one_layer(scene: Scene) -> Scene:
    material = scene.material
    masks = np.ones_like(material.masks[:1])
    return replace(scene, material=replace(material, layers=material.layers[:1], masks=masks))


def test_intensity_is_that_of_the_texture_at_the_point() -> None:
    _, found, (expected,) = reflectances(of_one_layer(plain()))
    # Points are rounded to float32, which may be another texel at its edge.
    assert (np.abs(found / expected - 1) < 1e-4).mean() > 0.99


def test_intensity_follows_the_relief_where_layers_meet() -> None:
    scene = plain()
    xy_m, found, texels = reflectances(scene)
    darker, brighter = np.min(texels, axis=0), np.max(texels, axis=0)
    assert ((0.9999 * darker < found) & (found < 1.0001 * brighter)).mean() > 0.99
    # Of the two checkered textures, the higher squares are seen, as far as the masks allow.
    layers = scene.material.layers
    is_high = [
        texel > linear(each.maps.color_srgb / 255).mean()
        for texel, each in zip(texels, layers, strict=True)
    ]
    weights = scene.material.weights_at(xy_m)
    is_even = np.abs(weights[:, 0] - 0.5) < 0.1
    for own, other in ((0, 1), (1, 0)):
        above = is_even & is_high[own] & ~is_high[other]
        share = (found - texels[other])[above] / (texels[own] - texels[other])[above]
        assert above.sum() > 20
        assert share.min() > 0.8


def test_intensity_has_the_slow_variation_of_the_grounds_colour() -> None:
    scene = plain()
    macro = MacroPattern(1.0, 3)
    varied = replace(scene, material=replace(scene.material, macro=macro))
    xy_m, found, _ = reflectances(varied)
    _, even, _ = reflectances(scene)
    np.testing.assert_allclose(found / even, macro.factors_at(xy_m).mean(axis=1), rtol=1e-3)
    assert np.ptp(found / even) > 0.1


def test_a_beam_averages_the_texture_over_its_width() -> None:
    for scene, tolerance in ((of_one_layer(plain()), 1e-5), (plain(), 0.03)):
        placed, surface = lidar(), Surface(scene, None)
        view = surface.cast(*rays_in_map(placed, placed.pattern.directions), 60.0)
        view = view.rows(np.flatnonzero(view.is_hit[:, 0]))
        weights = scene.material.weights_at(view.points_m[:, 0, :2])
        means = [linear(la.maps.color_srgb / 255).mean() for la in scene.material.layers]
        reflectance = Reflectance(scene)
        wide, narrow = (reflectance.at(view, np.full(len(weights), m)) for m in (10.0, 0.01))
        np.testing.assert_allclose(wide, weights @ means, rtol=tolerance)
        assert np.median(np.abs(narrow / wide - 1)) > 0.2


def test_points_outside_the_range_limits_are_missing() -> None:
    every = ranges_m(scanned(plain(), lidar()))
    kept = ranges_m(scanned(plain(), lidar(min_range_m=4.0, max_range_m=9.0)))
    np.testing.assert_array_equal(kept, every[(every >= 4) & (every <= 9)])


def test_range_noise_is_seeded_and_has_the_configured_deviation() -> None:
    errors = LidarErrors(seed=3, range_sigma_m=0.02)
    true = scanned(plain(), lidar())
    noisy = scanned(plain(), lidar(errors=errors))
    error_m = ranges_m(noisy) - ranges_m(true)
    assert error_m.std() == pytest.approx(0.02, rel=0.1)
    assert abs(error_m.mean()) < 0.003
    same, other = (
        scanned(plain(), lidar(errors=errors), CaptureId(1, sample, "lidar")) for sample in (1, 2)
    )
    np.testing.assert_array_equal(same.data, noisy.data)
    assert (ranges_m(other) != ranges_m(noisy)).all()


def test_rays_are_lost_at_grazing_incidence() -> None:
    true = scanned(plain(), lidar())
    kept = scanned(plain(), lidar(errors=LidarErrors(drop_from_rad=np.radians(60))))
    incidence = np.degrees(np.arccos(-true.points_m[:, 2] / ranges_m(true)))
    left = np.degrees(np.arccos(-kept.points_m[:, 2] / ranges_m(kept)))
    assert (left < 60).sum() == (incidence < 60).sum()
    expected = (1 - (incidence[incidence > 60] - 60) / 30).sum()
    assert (left > 60).sum() == pytest.approx(expected, abs=4 * np.sqrt(expected))


def test_a_beam_at_an_edge_returns_twice() -> None:
    scene = replace(flat_world(), primitives=(BOX,))
    thin = scanned(scene, lidar(extra_fields=("instance",)))
    wide = scanned(scene, lidar(extra_fields=("instance",), beam_divergence_rad=0.02))
    keys = list(zip(wide.data["time"], wide.data["ring"], strict=True))
    twice = [i for i in range(1, len(keys)) if keys[i] == keys[i - 1]]
    assert 5 < len(twice) < 200
    assert len(thin.data) == len(set(zip(thin.data["time"], thin.data["ring"], strict=True)))
    range_m, ids = ranges_m(wide), wide.data["instance"]
    for second in twice:
        assert range_m[second] > range_m[second - 1] + 0.4
        assert (ids[second - 1], ids[second]) == (BOX.instance_id, 0)
    # On level ground below, no beam meets two surfaces.
    steep = scanned(plain(), looking_at(np.array((0.0, 0.0, GROUND_M)), 4.0))
    assert len(steep.data) == 121


def test_a_beams_rays_are_half_its_divergence_from_its_axis() -> None:
    axes = np.array(((1.0, 0, 0), (0, 0, 1.0), (0.6, 0.0, -0.8)))
    rays = beam(axes, 0.01)
    np.testing.assert_array_equal(rays[0], axes)
    angles = np.arccos(np.clip((rays[1:] * axes).sum(axis=-1), -1, 1))
    np.testing.assert_allclose(angles, 0.005, rtol=1e-4)
    np.testing.assert_allclose(rays[1:].sum(axis=0) / 4, axes, atol=2e-5)


def test_a_lidar_in_the_dark_sky_returns_no_points() -> None:
    up = ScanPattern(np.array(((0.0, 0.0, 1.0),)), np.zeros(1), np.zeros(1, np.uint16))
    assert len(scanned(plain(), lidar(pattern=up)).data) == 0
    assert len(scanned(plain(), lidar(pattern=up, beam_divergence_rad=0.01)).data) == 0


def test_64_channels_of_1024_steps_take_a_tenth_of_a_second_of_processor_time() -> None:
    backend = AnalyticBackend()
    backend.build(rocky_world(), lambda _: None)
    placed = lidar(pattern=rotating(RotatingScanConfig(preset="generic_64"), 0.1))
    seconds = []
    for _ in range(5):
        before_s = time.process_time()
        scan = backend.scan(placed, CAPTURE)
        seconds.append(time.process_time() - before_s)
    assert len(scan.data) > 30_000
    load_factor = 3
    assert min(seconds) < 0.1 * load_factor


def test_intensity_of_ground_follows_its_law() -> None:
    """Lommel and Seeliger's law is as bright to its own light from all sides: (1 + cos 30°) / 2."""
    material = replace(plain().material, is_lambertian=True)
    by_law = replace(material, law=LommelSeeliger())
    of_lambert, found = (
        scanned(replace(plain(), material=each), lidar()).data for each in (material, by_law)
    )
    xyz = np.stack([found[axis] for axis in "xyz"], axis=-1)
    down = TURNED[:3, :3].T @ (0.0, 0.0, -1.0)
    incidence_cos = xyz @ down / np.linalg.norm(xyz, axis=-1)
    expected = of_lambert["intensity"] * (1 + np.cos(np.pi / 6)) / (2 * incidence_cos)
    np.testing.assert_allclose(found["intensity"], expected, rtol=1e-4)
