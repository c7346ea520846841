"""The ground's material in Blender: its colours lie where its labels do."""

from dataclasses import replace
from functools import cache
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter
from synthetic_worlds import (
    SUNNY,
    camera,
    flat_world,
    rocky_world,
    settings,
    with_separate_rocks,
)

from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.procedural.scatter.rocks import DUST_M, make_rock
from oaisys_core.procedural.terrain.macro_variation import MacroPattern
from oaisys_core.scene import (
    HeightField,
    PbrMaps,
    PlacedCamera,
    Placement,
    Scene,
    TerrainLayer,
    TerrainMaterial,
)
from oaisys_core.scene.sky import Clouds
from oaisys_core.scene.terrain_material import LabelImage, Variation
from oaisys_core.scene.tiling import PlainTiling, Tiling, stochastic_tiling, voronoi_tiling
from oaisys_core.types import (
    ALBEDO,
    DEPTH,
    INSTANCE,
    RGB,
    SEMANTIC_0,
    FloatArray,
    Frame,
    PinholeIntrinsics,
)

pytestmark = pytest.mark.blender

NO_VARIATION = Variation(brightness=0.0)
BRIGHT = replace(SUNNY, sun_elevation_rad=1.4)
VIEW = PinholeIntrinsics(96, 96, 100.0, 100.0, 47.5, 47.5)
TILE_M = 4.0


def checked(is_light: NDArray[np.bool_]) -> PbrMaps:
    """A texture of two shades, each pixel of the pattern 16 texels wide."""
    shade = np.kron(np.where(is_light, 220, 40), np.ones((16, 16))).astype(np.uint8)
    size = len(shade)
    return PbrMaps(
        "checked",
        np.stack([shade] * 3, axis=-1),
        np.zeros((size, size), np.float32),
        np.full((size, size, 3), (128, 128, 255), np.uint8),
        np.full((size, size), 255, np.uint8),
        TILE_M,
    )


def world(ground: HeightField, layers: tuple[TerrainLayer, ...], **more: Any) -> Scene:
    masks = np.zeros((len(layers), 4, 4), np.float32)
    masks[0] = 1
    material = TerrainMaterial(layers, masks, ground.extent_m, variation=NO_VARIATION, **more)
    return replace(flat_world(), ground=ground, material=material, primitives=(), sky=BRIGHT)


def level() -> HeightField:
    return HeightField(np.zeros((3, 3), np.float32), (-20.0, -20.0), 20.0)


@cache
def cases() -> dict[str, tuple[Scene, PlacedCamera]]:
    pattern = np.random.default_rng(3).random((4, 4)) > 0.5
    image = LabelImage(np.where(pattern, 2, 1).astype(np.uint16)[None])
    rng = np.random.default_rng(4)
    tilings: dict[str, Tiling] = {
        "plain": PlainTiling(),
        "voronoi": voronoi_tiling(1.5, np.pi, rng),
        "stochastic": stochastic_tiling(2.0, rng),
    }
    # Above a ground far from the origin's tiles, so that a mirrored or shifted axis would show.
    down = camera(pose_looking_down(5.3, -3.1, 9.0, 0.3), VIEW, (RGB, DEPTH, SEMANTIC_0))
    found = {
        name: (world(level(), (TerrainLayer("a", (9,), checked(pattern), tiling, image),)), down)
        for name, tiling in tilings.items()
    }
    stripes = np.zeros((4, 4), bool)
    stripes[::2] = True
    layer = TerrainLayer("a", (9,), checked(stripes))
    axis_m = np.linspace(-10, 10, 41)
    height_m = np.broadcast_to(np.tan(np.radians(75)) * axis_m[:, None], (41, 41))
    wall = HeightField(height_m.astype(np.float32), (-10.0, -10.0), 0.5)
    ahead = camera(pose_looking_at((0, -9, 2.4), (0, 0, 0)), VIEW, (RGB,))
    for name, sides in (("wall from above", False), ("wall from the side", True)):
        found[name] = (world(wall, (layer,), projects_sides=sides), ahead)
    plain = checked(np.ones((4, 4), bool))
    upright = camera(pose_looking_at((0, -9, 2.4), (0, 0, 0)), VIEW, (ALBEDO,))
    macro = MacroPattern(1.0, 3)
    bedded = world(wall, (TerrainLayer("a", (9,), plain),), projects_sides=True, macro=macro)
    found["beds"] = (bedded, upright)
    # Single texels of 220 and 40, 1.6 cm wide, in pixels of 30 cm; and their mean in linear light.
    for name, shades in {"fine": (220, 40), "even": (163, 163)}.items():
        maps = checked(np.indices((4, 4)).sum(axis=0) % 2 == 0)
        shade = np.where(np.indices((256, 256)).sum(axis=0) % 2, *shades).astype(np.uint8)
        maps = replace(
            maps,
            color_srgb=np.stack([shade] * 3, axis=-1),
            height=np.zeros((256, 256), np.float32),
            normal_gl=np.full((256, 256, 3), (128, 128, 255), np.uint8),
            roughness=np.full((256, 256), 255, np.uint8),
        )
        high = camera(pose_looking_down(1.0, 2.0, 30.0), VIEW, (RGB,))
        found[name] = (world(level(), (TerrainLayer("a", (9,), maps),)), high)
    T = np.diag((2.0, 2.0, 2.0, 1.0))
    T[:2, 3] = (0.2, 0.9)
    boulder = make_rock("boulder", np.random.default_rng(0), 2)
    # So deep that its rim is seen from above: it is widest below.
    T[2, 3] = -0.7 * 2.0 * boulder.vertices_m[:, 2].max()
    placed = Placement(0, (10,), T[None], np.array([1], np.uint32))
    near = camera(pose_looking_down(0.0, 0.0, 6.0), VIEW, (ALBEDO, INSTANCE))
    for name, dust_m in {"rock": DUST_M, "clean rock": 0.0}.items():
        rock = replace(boulder, dust_m=dust_m)
        scene = replace(found["even"][0], prototypes=(rock,), placements=(placed,))
        found[name] = (scene, near)
    return found


@cache
def seen(name: str) -> tuple[Frame, ...]:
    (frames,) = in_blender("materials.views", [cases()[name]])
    return tuple(frames)


@pytest.mark.long
@pytest.mark.parametrize("name", ["plain", "voronoi", "stochastic"])
def test_colours_lie_where_labels_do(name: str) -> None:
    rgb, depth, semantic = (frame.data for frame in seen(name))
    scene, placed = cases()[name]
    layer = scene.material.layers[0]
    heaviest = layer.tiling.samples(_ground_xy(placed, depth) / TILE_M).weights.max(axis=0)
    clear = (heaviest > 0.9).reshape(depth.shape)
    clear &= minimum_filter(semantic, 5) == maximum_filter(semantic, 5)
    assert clear.mean() > 0.1
    assert set(np.unique(semantic)) == {1, 2}
    light = rgb.mean(axis=-1)
    middle = (light[clear & (semantic == 1)].mean() + light[clear & (semantic == 2)].mean()) / 2
    assert ((light > middle) == (semantic == 2))[clear].mean() > 0.995


def _ground_xy(placed: PlacedCamera, depth_m: NDArray[np.float32]) -> FloatArray:
    k = placed.intrinsics
    v, u = np.indices(depth_m.shape).reshape(2, -1)
    z = depth_m.ravel().astype(float)
    points = np.column_stack(((u - k.cx_px) / k.fx_px * z, (v - k.cy_px) / k.fy_px * z, z))
    return np.asarray((points @ placed.T_map_camera[:3, :3].T + placed.T_map_camera[:3, 3])[:, :2])


@pytest.mark.long
def test_a_steep_slope_shows_its_texture_undistorted() -> None:
    # Stripes are 1 m wide in height from the side, but tan(75 deg) = 3.7 m from above.
    def changes(name: str) -> int:
        column = seen(name)[0].data.mean(axis=-1)[:, 44:52].mean(axis=1)
        is_light = column > (column.min() + column.max()) / 2
        return int(np.count_nonzero(np.diff(is_light)))

    assert changes("wall from the side") >= 2.5 * changes("wall from above") > 0


def test_texels_smaller_than_a_pixel_are_seen_as_their_mean() -> None:
    fine, even = (seen(name)[0].data[32:64, 32:64].astype(float) for name in ("fine", "even"))
    assert fine.mean() == pytest.approx(even.mean(), abs=1.5)
    # A few light samples would hit white or black texels by chance.
    assert np.abs(fine - even).max() < 8


@pytest.mark.long
def test_cliffs_have_level_beds_and_no_streaks() -> None:
    (frame,) = seen("beds")
    albedo = frame.data.mean(axis=-1)
    beds = albedo.mean(axis=1)
    assert beds.std() > 5
    assert (albedo - beds[:, None]).std() < 0.5 * beds.std()
    red, _, blue = (channel.mean(axis=1) for channel in np.moveaxis(frame.data, -1, 0))
    assert np.log(blue / red).std() < 0.3 * np.log(beds).std()  # dark beds are not blue


def test_fines_and_a_dark_contact_are_around_rocks_only() -> None:
    (albedo, instance), (clean, _) = ([f.data for f in seen(n)] for n in ("rock", "clean rock"))
    is_rock = instance > 0
    beside = maximum_filter(is_rock, 3) & ~is_rock
    near = maximum_filter(is_rock, 5) & ~maximum_filter(is_rock, 3)
    far = ~maximum_filter(is_rock, 25)
    light, of_clean = albedo.mean(axis=-1), clean.mean(axis=-1)
    assert light[beside].mean() < 0.93 * of_clean[beside].mean()
    assert light[near].mean() > 1.05 * light[beside].mean()
    assert np.abs(light - of_clean)[far].max() <= 1


def test_another_material_leaves_nothing_of_the_old_one() -> None:
    scenes = [scene for scene, _ in cases().values()]
    order = [*scenes, *scenes]
    counts = in_blender(
        "materials.blocks",
        [replace(scene, stage_hash=str(index)) for index, scene in enumerate(order)],
    )
    assert counts[len(scenes) :] == counts[: len(scenes)]


def test_cycles_keeps_its_images_until_a_render_goes_without_them() -> None:
    """A new one at the address of one before would be shown with that one's pixels."""
    rocky = with_separate_rocks(rocky_world())
    skies = [
        replace(SUNNY, model="none", clouds=Clouds(0.4, 60.0, 30.0, 1500.0, seed=seed))
        for seed in (1, 2)
    ]
    first, second = (replace(rocky, sky=sky) for sky in skies)
    (placement, *_) = rocky.placements
    ground = replace(
        rocky.material, layers=rocky.material.layers[:1], masks=rocky.material.masks[:1]
    )
    clear = replace(rocky, sky=SUNNY, material=ground, placements=())
    few = replace(first, placements=(placement,))
    scenes = [first, second, few, clear, second, first, second, first]
    view = camera(pose_looking_at((-9.0, 0.0, 3.0), (0.0, 0.0, 0.5)), modalities=(RGB,))
    quick, draft = settings(), replace(settings(), quality="draft")
    changes = in_blender(
        "materials.images_through_updates", scenes, view, [quick] * 5 + [draft] * 3
    )
    removed, present, left = zip(*changes, strict=True)
    assert removed == (0,) * len(changes)
    # A render that Cycles made lets go of what nothing uses; drafts pile nothing up.
    assert present[0] == left[0] + 2
    assert left[3] == left[0]
    assert len(set(left[4:])) == 1


def test_levels_have_no_lookup_in_common() -> None:
    # Texels of 6 and 11 cm: two levels show the same image of the coarser ones. Cycles would
    # merge equal lookups and evaluate them for both levels.
    fine = replace(checked(np.eye(4, dtype=bool)), height=np.eye(64, dtype=np.float32))
    coarse = replace(fine, name="coarse", tile_m=1.8 * TILE_M)
    layers = (TerrainLayer("a", (1,), fine), TerrainLayer("b", (2,), coarse))
    scene = world(level(), layers)
    scene = replace(scene, material=replace(scene.material, variation=Variation()))
    lookups = in_blender("materials.lookups_by_level", scene)
    images = [{name for name, _ in of_level} for of_level in lookups]
    assert any(one & other for one, other in pairwise(images))
    assert not any(one & other for one, other in combinations(lookups, 2))


def test_a_camera_with_other_pixels_compiles_no_material_again() -> None:
    is_light = np.random.default_rng(8).uniform(size=(64, 64)) > 0.5
    layer = TerrainLayer("checked", (1,), checked(is_light))
    scene = replace(with_separate_rocks(rocky_world()), sky=BRIGHT)
    scene = replace(
        world(level(), (layer,)), placements=scene.placements, prototypes=scene.prototypes
    )
    pose = pose_looking_at((-9.0, 0.0, 3.0), (0.0, 0.0, 0.5))
    wide = replace(VIEW, width_px=32, height_px=24, fx_px=8.0, fy_px=8.0, cx_px=15.5, cy_px=11.5)
    narrow = replace(wide, fx_px=64.0, fy_px=64.0)
    first, second = (camera(pose, each, (RGB,)) for each in (wide, narrow))

    alone, _ = in_blender("materials.rendered_after", scene, [], second)
    after, kinds = in_blender("materials.rendered_after", scene, [first, second, first], second)

    assert "Object" in kinds
    assert not any("Material" in kind or "Tree" in kind for kind in kinds)
    np.testing.assert_array_equal(after[0].data, alone[0].data)
