"""Scattered groups: laws of size, distances, densities and stances, against closed forms."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import stats
from scipy.spatial import cKDTree
from synthetic_worlds import flat_world

from oaisys_core import randomness
from oaisys_core.config import config_from_mapping
from oaisys_core.config.sections.groups import GroupConfig
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.procedural.scatter.groups import group_sizes_m, scatter_group
from oaisys_core.procedural.scatter.placement.density import band, make_density
from oaisys_core.procedural.scatter.placement.spacing import Spacing, first_come, pairs_too_near
from oaisys_core.procedural.scatter.rocks import make_rock
from oaisys_core.procedural.scatter.shapes import PLANTS, make_shape
from oaisys_core.procedural.terrain.presets import make_ground
from oaisys_core.scene import HeightField, MeshPrototype
from oaisys_core.types import FloatArray

EXTENT_M = 40.0


def group(**keys: object) -> GroupConfig:
    given = {"name": "g", "shape": "pebble", "count": (1, 1), "label": "rock", "semantic_id": 10}
    return GroupConfig.model_validate(given | keys)


@pytest.fixture(scope="module")
def shapes() -> list[MeshPrototype]:
    return [make_rock("rounded", np.random.default_rng(seed), 1) for seed in range(3)]


def inclined(slope_x: float, slope_y: float = 0.0) -> HeightField:
    axis = np.linspace(-EXTENT_M / 2, EXTENT_M / 2, 129)
    height = slope_x * axis[None, :] + slope_y * axis[:, None]
    return HeightField(height, (-EXTENT_M / 2, -EXTENT_M / 2), EXTENT_M / 128)


def bowl() -> HeightField:
    """A paraboloid, on which slope and height are known everywhere."""
    axis = np.linspace(-EXTENT_M / 2, EXTENT_M / 2, 513)
    height = 0.02 * (axis[None, :] ** 2 + axis[:, None] ** 2)
    return HeightField(height, (-EXTENT_M / 2, -EXTENT_M / 2), EXTENT_M / 512)


def random_places(count: int = 4000) -> FloatArray:
    return np.random.default_rng(5).uniform(-19, 19, (count, 2))


def test_a_power_law_is_the_truncated_pareto_distribution() -> None:
    config = group(size_m=(0.05, 2.0), size_exponent=2.3)
    sizes_m = group_sizes_m(config, 20_000, np.random.default_rng(0))
    law = stats.truncpareto(b=2.3, c=2.0 / 0.05, scale=0.05)
    assert stats.kstest(sizes_m, law.cdf).pvalue > 0.01
    assert (np.diff(sizes_m) <= 0).all(), "largest first"


def test_normal_sizes_are_cut_off_at_the_range() -> None:
    config = group(size_m=(0.2, 0.5), size_distribution="normal", size_mean_m=0.3, size_std_m=0.1)
    sizes_m = group_sizes_m(config, 20_000, np.random.default_rng(1))
    law = stats.truncnorm(-1.0, 2.0, loc=0.3, scale=0.1)
    assert stats.kstest(sizes_m, law.cdf).pvalue > 0.01


def test_uniform_sizes_and_a_single_one() -> None:
    config = group(size_m=(0.2, 0.6), size_distribution="uniform")
    sizes_m = group_sizes_m(config, 20_000, np.random.default_rng(2))
    assert stats.kstest(sizes_m, stats.uniform(0.2, 0.4).cdf).pvalue > 0.01
    assert set(group_sizes_m(group(size_m=0.3), 5, np.random.default_rng(0))) == {0.3}


@pytest.mark.parametrize("keys", [{"spacing_m": 0.7, "spacing": 0.0}, {"spacing": 1.0}])
def test_things_keep_their_distance(keys: dict[str, float], shapes: list[MeshPrototype]) -> None:
    config = group(size_m=(0.1, 1.0), count=(900, 900), **keys)
    T, _ = scatter_group(config, 900, shapes, inclined(0.0), np.random.default_rng(3))
    xy, sizes_m = T[:, :2, 3], np.linalg.norm(T[:, :3, 0], axis=1)
    i, j = cKDTree(xy).query_pairs(1.1, output_type="ndarray").T
    least_m = np.maximum(config.spacing * (sizes_m[i] + sizes_m[j]) / 2, config.spacing_m)
    assert (np.linalg.norm(xy[i] - xy[j], axis=1) >= least_m - 1e-12).all()
    assert len(T) == 900


def test_a_full_poisson_disk_sampling_leaves_no_large_gap(shapes: list[MeshPrototype]) -> None:
    config = group(size_m=0.1, count=(9000, 9000), spacing_m=1.0)
    T, _ = scatter_group(config, 9000, shapes, inclined(0.0), np.random.default_rng(4))
    gap_m, _ = cKDTree(T[:, :2, 3]).query(random_places())
    # Disks of the least distance cover nearly everything once no more fit in.
    assert (gap_m < 1.0).mean() > 0.98
    # Disks thrown at random, never to overlap, jam at a coverage of 0.547.
    jammed = 0.547 * (EXTENT_M - 0.1) ** 2 / (np.pi / 4)
    assert 0.85 * jammed < len(T) < 1.02 * jammed


@pytest.mark.parametrize(
    ("keys", "least", "most"),
    [
        ({"shape": "sedge"}, 2.0, 30.0),
        ({"shape": "sedge", "spacing_m": 0.05}, 0.5, 1.3),
        ({"shape": "pebble"}, 0.5, 1.3),
        ({"shape": "meadow"}, 0.5, 1.3),
    ],
)
def test_plants_stand_in_clumps_unless_they_keep_a_distance(
    keys: dict[str, object], least: float, most: float, shapes: list[MeshPrototype]
) -> None:
    """Variance over mean of the counts in squares is 1 if things are strewn (Clapham, 1936)."""
    config = group(size_m=0.2, count=(3000, 3000), spacing=0.0, **keys)
    T, _ = scatter_group(config, 3000, shapes, inclined(0.0), np.random.default_rng(3))
    assert len(T) == 3000
    square = np.floor(T[:, :2, 3] / 1.5).astype(int) + 13
    inside = square[((square >= 0) & (square < 26)).all(axis=1)]
    counts = np.bincount(26 * inside[:, 0] + inside[:, 1], minlength=26**2)
    assert least < counts.var() / counts.mean() < most


def test_who_comes_first_stays() -> None:
    rng = np.random.default_rng(6)
    xy, sizes_m = rng.uniform(0, 10, (500, 2)), rng.uniform(0.2, 1.0, 500)
    pairs = pairs_too_near(xy, sizes_m, Spacing(1.0))
    stays: list[int] = []
    for k in range(500):
        distance_m = np.linalg.norm(xy[stays] - xy[k], axis=1)
        if (distance_m >= (sizes_m[stays] + sizes_m[k]) / 2).all():
            stays.append(k)
    assert np.flatnonzero(first_come(500, pairs)).tolist() == stays


def test_densities_of_slope_and_height_are_those_of_the_paraboloid() -> None:
    xy = random_places()
    distance_m = np.linalg.norm(xy, axis=1)
    ground, rng = bowl(), np.random.default_rng(0)
    slope = group(density=[{"kind": "slope", "range_deg": [10, 25], "fade_deg": 4}]).density
    slope_deg = np.degrees(np.arctan(0.04 * distance_m))
    expected = np.interp(slope_deg, [8, 12, 23, 27], [0, 1, 1, 0])
    assert np.abs(make_density(slope, ground, rng)(xy) - expected).max() < 0.02
    height = group(density=[{"kind": "height", "range_m": [2, 6], "fade_m": 1, "least": 0.2}])
    expected = 0.2 + 0.8 * np.interp(0.02 * distance_m**2, [1.5, 2.5, 5.5, 6.5], [0, 1, 1, 0])
    assert np.abs(make_density(height.density, ground, rng)(xy) - expected).max() < 0.01
    share = group(density=[{"kind": "height", "range_share": [0, 0.25], "fade_m": 0}]).density
    expected = (0.02 * distance_m**2 <= 4).astype(float)
    assert (make_density(share, ground, rng)(xy) == expected).mean() > 0.999


def test_an_image_lies_with_its_upper_edge_at_the_largest_y(tmp_path: Path) -> None:
    image = np.zeros((64, 32), np.uint16)
    image[:16, :16] = 65535
    cv2.imwrite(str(tmp_path / "map.png"), image)
    maps = group(density=[{"kind": "image", "file": tmp_path / "map.png"}]).density
    density = make_density(maps, inclined(0.0), np.random.default_rng(0))
    assert density(np.array([(-15.0, 15.0), (15.0, 15.0), (-15.0, -15.0), (-15.0, 5.0)])) == (
        pytest.approx([1, 0, 0, 0])
    )


def test_an_image_of_floats_is_refused_by_its_type(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "map.tif"), np.zeros((8, 8), np.float32))
    maps = group(density=[{"kind": "image", "file": tmp_path / "map.tif"}]).density
    with pytest.raises(InvalidInputError, match=r"density\.file.*8 or 16 bits, not of float32"):
        make_density(maps, inclined(0.0), np.random.default_rng(0))


def test_objects_stand_where_the_layer_lies_and_as_densely_as_its_weight() -> None:
    ground, material = inclined(0.0), flat_world().material
    config = group(density=[{"kind": "layer", "label": "gravel"}], spacing=0, size_m=(0.01, 0.01))
    shapes = [make_rock("rounded", np.random.default_rng(1), 1)]
    T, _ = scatter_group(config, 20_000, shapes, ground, np.random.default_rng(2), material)
    weights = material.weights_at(T[:, :2, 3])
    everywhere = material.weights_at(np.random.default_rng(3).uniform(-19.9, 19.9, (20_000, 2)))
    expected = (everywhere[:, 0] ** 2).mean() / everywhere[:, 0].mean()
    assert weights[:, 0].mean() == pytest.approx(expected, abs=0.01)
    nowhere = group(density=[{"kind": "layer", "label": "ice"}])
    assert (
        len(scatter_group(nowhere, 9, shapes, ground, np.random.default_rng(2), material)[0]) == 0
    )


def test_a_density_may_name_several_layers() -> None:
    ground, material = inclined(0.0), flat_world().material
    names = [layer.label for layer in material.layers[:2]]
    maps = group(density=[{"kind": "layer", "label": names}]).density
    density = make_density(maps, ground, np.random.default_rng(0), material)
    xy = random_places()
    expected = material.weights_at(xy)[:, :2].sum(axis=1)
    assert density(xy) == pytest.approx(np.minimum(expected, 1))


@pytest.mark.parametrize("label", ["grave", ["sand", "grave"]])
def test_a_density_of_a_layer_that_no_layer_is_called_is_refused(label: str | list[str]) -> None:
    stones = group(density=[{"kind": "layer", "label": label}]).model_dump(mode="json")
    with pytest.raises(
        ConfigError, match=r"assets.groups.g.density.0.label: .*did you mean gravel"
    ):
        config_from_mapping({"assets": {"groups": [stones]}})


def test_a_density_of_a_layer_names_its_label_on_level_0_or_its_folder(tmp_path: Path) -> None:
    """A name of another level was accepted and nothing stood anywhere; one of a folder refused."""
    (tmp_path / "trail").mkdir()
    layer = {"label": "gravel", "semantic_id": 1, "levels": [{"label": "loose", "semantic_id": 9}]}
    materials = {"layers": [layer], "pools": [{"folder": str(tmp_path)}]}

    def named(label: str) -> None:
        stones = group(density=[{"kind": "layer", "label": label}]).model_dump(mode="json")
        config_from_mapping({"materials": materials, "assets": {"groups": [stones]}})

    named("trail")
    with pytest.raises(ConfigError, match=r"received 'loose', expected .*gravel"):
        named("loose")


@pytest.mark.parametrize("kind", ["noise", "voronoi"])
def test_patches_and_cells_cover_their_share(kind: str) -> None:
    borders = {"noise": {"softness": 0}, "voronoi": {"border_m": 0, "cell_m": 2}}
    maps = group(density=[{"kind": kind, "cover": 0.3} | borders[kind]]).density
    density = make_density(maps, inclined(0.0), np.random.default_rng(3))
    assert (density(random_places()) > 0.5).mean() == pytest.approx(0.3, abs=0.07)


def test_cells_fade_towards_their_borders() -> None:
    maps = group(density=[{"kind": "voronoi", "cell_m": 4, "border_m": 1.0}]).density
    density = make_density(maps, inclined(0.0), np.random.default_rng(3))
    line = np.column_stack((np.linspace(-19, 19, 20_001), np.zeros(20_001)))
    values = density(line)
    # Over a step of 1.9 mm, the distance to a border changes by at most 1.9 mm.
    assert np.abs(np.diff(values)).max() <= 38 / 20_000 + 1e-9
    assert {0.0, 1.0} <= {float(values.min()), round(float(values.max()), 6)}


def test_places_follow_the_density(shapes: list[MeshPrototype]) -> None:
    """On a ramp of density, the heights of things are distributed as its integral says."""
    ramp = {"kind": "height", "range_m": [10, 99], "fade_m": 40}
    config = group(count=(4000, 4000), size_m=0.01, density=[ramp], spacing=0, max_slope_deg=90)
    T, _ = scatter_group(config, 4000, shapes, inclined(1.0), np.random.default_rng(7))
    share = (T[:, 0, 3] + 10) / 30
    inside = share[(share > 0) & (share < 1)]
    assert (share >= 0).all()
    assert stats.kstest(inside, lambda x: x**2).pvalue > 0.01


def test_bands_are_told_by_the_docstring() -> None:
    assert band(np.array([0.0, 1.0, 1.5, np.nan]), 1.0, 3.0, 1.0).tolist() == [0, 0.5, 1, 0]


@pytest.mark.parametrize("align", [0.0, 0.5, 1.0])
def test_things_lean_with_their_share_of_the_slope(
    align: float, shapes: list[MeshPrototype]
) -> None:
    config = group(count=(50, 50), align=align, tilt_deg=0, size_m=0.2)
    ground = inclined(np.tan(np.radians(30)))
    T, _ = scatter_group(config, 50, shapes, ground, np.random.default_rng(8))
    up = T[:, :3, 2] / 0.2
    angle = np.radians(30 * align)
    assert np.allclose(up, (-np.sin(angle), 0, np.cos(angle)), atol=1e-4)


def test_yaw_is_within_its_range(shapes: list[MeshPrototype]) -> None:
    config = group(count=(300, 300), yaw_deg=(10, 30), tilt_deg=0)
    T, _ = scatter_group(config, 300, shapes, inclined(0.0), np.random.default_rng(9))
    yaw_deg = np.degrees(np.arctan2(T[:, 1, 0], T[:, 0, 0]))
    assert 10 <= yaw_deg.min() < 12
    assert 28 < yaw_deg.max() <= 30


@pytest.mark.parametrize("align", [0.0, 1.0])
def test_nothing_floats_and_nothing_is_buried(align: float, shapes: list[MeshPrototype]) -> None:
    ground = make_ground("mounds", EXTENT_M, 257, np.random.default_rng(0))
    config = group(count=(300, 300), align=align, size_m=(0.2, 1.0), sink=(0.1, 0.4))
    T, shape_of = scatter_group(config, 300, shapes, ground, np.random.default_rng(10))
    for pose, shape in zip(T, shape_of, strict=True):
        vertices_m = shapes[shape].vertices_m @ pose[:3, :3].T + pose[:3, 3]
        above_m = vertices_m[:, 2] - ground.height_at(vertices_m[:, :2])
        assert np.nanmin(above_m) < 0 < np.nanmax(above_m)


def test_a_hundred_thousand_pebbles_are_placed(shapes: list[MeshPrototype]) -> None:
    config = group(count=(100_000, 100_000), size_m=(0.02, 0.12), size_exponent=2.5)
    T, _ = scatter_group(config, 100_000, shapes, bowl(), np.random.default_rng(11))
    assert len(T) == 100_000
    assert (cKDTree(T[:, :2, 3]).query(T[:, :2, 3], k=2)[0][:, 1] >= 0.5 * 0.02).all()


def test_draws_repeat_and_parts_do_not_reshuffle_each_other(shapes: list[MeshPrototype]) -> None:
    def poses(**keys: object) -> FloatArray:
        rng = np.random.default_rng(12)
        return scatter_group(group(**keys), 200, shapes, inclined(0.1), rng)[0]

    assert poses().tobytes() == poses().tobytes()
    assert np.array_equal(poses()[:, :2, 3], poses(yaw_deg=(0, 10), tilt_deg=3)[:, :2, 3])


def test_a_child_stream_depends_on_the_seed_and_the_name_alone() -> None:
    rng = np.random.default_rng(1)
    first = randomness.child(rng, "a").uniform()
    rng.uniform(size=7)
    assert randomness.child(rng, "a").uniform() == first
    assert randomness.child(rng, "b").uniform() != first
    assert randomness.child(np.random.default_rng(2), "a").uniform() != first


@pytest.mark.parametrize("shape", sorted(PLANTS))
def test_plants_are_not_buried_though_nobody_says_how_they_stand(shape: str) -> None:
    made = make_shape(shape, np.random.default_rng(1))
    config = group(shape=shape, count=(60, 60), size_m=(0.8, 0.8))
    upright_m = 0.8 * float(np.ptp(made.vertices_m[:, 2]))
    for slope in (0.0, 0.4):
        rng = np.random.default_rng(2)
        T_map_object, _ = scatter_group(config, 60, [made], inclined(slope), rng)
        vertices_m = made.vertices_m @ T_map_object[:, :3, :3].transpose(0, 2, 1)
        vertices_m = vertices_m + T_map_object[:, None, :3, 3]
        above_m = vertices_m[..., 2] - slope * vertices_m[..., 0]
        height_m = above_m.max(axis=1)
        assert (above_m.min(axis=1) < 0.02).all(), f"rooted at slope {slope}"
        assert np.median(height_m) > 0.6 * upright_m, f"seen at slope {slope}"


@pytest.mark.parametrize(("shape", "depth_m"), [("birch", 0.0), ("reed", 1.0), ("pebble", 20.0)])
def test_plants_stand_in_water_as_deep_as_they_do(
    shape: str, depth_m: float, shapes: list[MeshPrototype]
) -> None:
    config = group(shape=shape, size_m=(0.5, 0.5), spacing=0.0)
    rng, ground = np.random.default_rng(4), inclined(0.2)
    T, _ = scatter_group(config, 2000, shapes, ground, rng, water_m=1.0)
    lowest_m = ground.height_at(T[:, :2, 3]).min()
    assert len(T) == 2000
    assert max(1.0 - depth_m, -4.0) <= lowest_m < max(1.0 - depth_m, -4.0) + 0.1
