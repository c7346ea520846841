"""Leaves, needles and blades have botanical sizes, whatever the size of the plant."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from synthetic_worlds import SMALL_MATERIALS

from oaisys_core.color import linear
from oaisys_core.config.sections.groups import GroupConfig
from oaisys_core.procedural.scatter.groups import scatter_group, size_classes_m
from oaisys_core.procedural.scatter.plants.organ_sizes import CLASS_RATIO, ORGANS, OrganSize
from oaisys_core.procedural.scatter.plants.organs import SPREAD
from oaisys_core.procedural.scatter.plants.species import WOODY
from oaisys_core.procedural.scatter.shapes import PLANTS, make_shape
from oaisys_core.scene import HeightField, MeshPrototype
from oaisys_core.types import FloatArray
from oaisys_core.world.modules.assets.prototypes import PrototypeLibrary

SIZES_M = (0.8, 1.0, 3.0, 8.0, 15.0)

BLADES = ("grass_tuft", "meadow", "sedge", "reed", "fern")
"""Plants whose organs are strips: left corners, right corners, tip."""

SHRUB_TRIANGLES = 30_000

TRIANGLES = {
    "birch": 110_000,
    "oak": 110_000,
    "pine": 60_000,
    "spruce": 60_000,
    "hawthorn": 50_000,
    "willow": 50_000,
}

GRAINS = 5
"""Corners of a grain in an ear, of which the reed's and the meadow's blades have more."""


def organs_of(plant: MeshPrototype, size_m: float, *, opaque: bool = False) -> list[FloatArray]:
    """Return (N, C, 3) corners of organs in metres, by their number of corners.

    Organs are what hangs together and lets light through, or all that hangs together.
    """
    a, b, c = plant.triangles.T
    count = len(plant.vertices_m)
    edges = coo_array((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, c])), shape=(count, count))
    _, part = connected_components(edges, directed=False)
    order = np.argsort(part, kind="stable")
    if not opaque:
        assert plant.translucency is not None
        order = order[plant.translucency[order] > 0]
    _, first, corners = np.unique(part[order], return_index=True, return_counts=True)
    found = []
    for number in np.unique(corners):
        rows = first[corners == number][:, None] + np.arange(number)
        found.append(plant.vertices_m[order[rows]].astype(np.float64) * size_m)
    return found


def distance(organs: FloatArray, first: int, last: int) -> FloatArray:
    """Return the (N,) distances of two corners."""
    return np.linalg.norm(organs[:, last] - organs[:, first], axis=-1)


def assert_within(values: FloatArray, limits: tuple[float, float], what: str) -> None:
    tolerance = 1e-3 * limits[1]
    assert limits[0] - tolerance <= values.min(), what
    assert values.max() <= limits[1] + tolerance, what


def test_every_plant_says_how_large_its_organs_are() -> None:
    assert ORGANS.keys() == PLANTS.keys()
    for organs in ORGANS.values():
        for organ in organs.values():
            for low_m, high_m in (organ.length_m, organ.width_m):
                assert 1.6 * low_m <= high_m, "room for what shares a mesh"


@pytest.mark.parametrize("size_m", SIZES_M)
@pytest.mark.parametrize("name", sorted(WOODY))
def test_leaves_and_needles_keep_their_sizes_on_plants_of_any_size(
    name: str, size_m: float
) -> None:
    plant = make_shape(name, np.random.default_rng(4), plant_m=size_m)
    limits = ORGANS[name].values()
    of_any = OrganSize(*(
        (min(low for low, _ in each), max(high for _, high in each))
        for each in ([o.length_m for o in limits], [o.width_m for o in limits])
    ))  # fmt: skip

    # A mesh is also that of the smallest and of the largest plants of its class.
    for shown_m in (size_m * CLASS_RATIO**-0.5, size_m * CLASS_RATIO**0.5):
        for organs in organs_of(plant, shown_m):
            are_needles = WOODY[name].foliage.shoot_m is not None
            if are_needles and organs.shape[1] > 3:
                assert_shoots(organs, name, of_any)
            else:
                assert_leaves(organs, of_any, are_needles=are_needles)

    assert len(plant.triangles) <= TRIANGLES.get(name, SHRUB_TRIANGLES)


def assert_leaves(organs: FloatArray, size: OrganSize, *, are_needles: bool) -> None:
    """Check needles (foot left, foot right, tip) and leaves."""
    if organs.shape[1] == 5:
        lengths_m, widths_m = distance(organs, 0, 4), distance(organs, 1, 3)
    elif are_needles:
        lengths_m = np.linalg.norm(organs[:, 2] - organs[:, :2].mean(axis=1), axis=1)
        widths_m = distance(organs, 0, 1)
    else:
        lengths_m, widths_m = distance(organs, 0, 2), distance(organs, 1, 3)
    assert_within(lengths_m, size.length_m, "length")
    assert_within(widths_m, size.width_m, "width")


def assert_shoots(organs: FloatArray, name: str, needle: OrganSize) -> None:
    """Check that shoots are as long as twigs, and as broad as needles allow."""
    shoot_m = WOODY[name].foliage.shoot_m
    assert shoot_m is not None
    assert shoot_m[1] <= 0.25
    corners = organs.shape[1]
    if corners == 5:
        for tip, side in ((1, 2), (3, 4)):
            assert_within(distance(organs, 0, tip), shoot_m, "length of a fork")
            ahead = organs[:, tip] - organs[:, 0]
            ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
            off = np.linalg.norm(np.cross(organs[:, side] - organs[:, 0], ahead), axis=1)
            assert_within(off / (2 * SPREAD), needle.length_m, "half width of a fork")
        return
    end, apexes = {7: (2, (0.32, 0.2, 0.7, 0.6)), 8: (3, (0.25, 0.45, 0.6, 0.9))}[corners]
    along = organs[:, end] - organs[:, 0]
    assert_within(np.linalg.norm(along, axis=1), shoot_m, "length of a shoot")
    for tooth, share in enumerate(apexes):
        root = organs[:, 0] + share * along
        teeth_m = np.linalg.norm(organs[:, end + 1 + tooth] - root, axis=1)
        assert_within(teeth_m, needle.length_m, "tooth")


@pytest.mark.parametrize("size_m", SIZES_M)
@pytest.mark.parametrize("name", BLADES)
def test_blades_and_leaflets_are_no_wider_on_larger_plants(name: str, size_m: float) -> None:
    plant = make_shape(name, np.random.default_rng(4), plant_m=size_m)
    (organ,) = ORGANS[name].values()
    for shown_m in (size_m * CLASS_RATIO**-0.5, size_m * CLASS_RATIO**0.5):
        for strips in organs_of(plant, shown_m):
            rows = strips.shape[1] // 2
            if strips.shape[1] == GRAINS and name != "fern":
                assert distance(strips, 1, 3).max() < 0.01, "grains and hairs"
                continue
            across = np.stack([distance(strips, row, row + rows) for row in range(rows)])
            widths_m = across.max(axis=0)
            # The width of a blade lies between two of its rows.
            assert_within(widths_m, (0.9 * organ.width_m[0], organ.width_m[1]), "width")
    assert len(plant.triangles) <= 60_000


@pytest.mark.parametrize("size_m", SIZES_M)
def test_leaflets_of_bracken_and_leaves_of_shrubs_keep_their_sizes(size_m: float) -> None:
    for name, corners, ends, sides in (
        ("bracken", 5, (0, 4), (1, 3)),
        ("shrub", 4, (0, 2), (1, 3)),
    ):
        plant = make_shape(name, np.random.default_rng(4), plant_m=size_m)
        size = ORGANS[name]["leaf"]
        for organs in organs_of(plant, size_m):
            assert organs.shape[1] == corners
            assert_within(distance(organs, *ends), size.length_m, name)
            assert_within(distance(organs, *sides), size.width_m, name)


@pytest.mark.parametrize(
    "name", ["birch", "oak", "willow", "spruce", "pine", "juniper", "meadow", "shrub", "fern"]
)
def test_leaves_reflect_blue_as_those_of_floras_do(name: str) -> None:
    plant = make_shape(name, np.random.default_rng(4))
    assert plant.translucency is not None
    assert plant.vertex_colors_srgb is not None
    leaves = linear(plant.vertex_colors_srgb[plant.translucency > 0] / 255)
    red, green, blue = leaves.mean(axis=0)
    # Fresh leaves of 45 species (Hosgood et al., LOPEX93, 1994) reflect 4 to 6 % of blue light,
    # and of the green some 9 to 15 %; dry blades more of both.
    assert 0.03 < blue < 0.09
    assert 0.25 < blue / green < 0.7
    assert red < green


def test_grass_gets_short_and_sparse_towards_the_rim_of_a_meadow() -> None:
    plant = make_shape("meadow", np.random.default_rng(4))
    blades = organs_of(plant, 1.0)
    (grass,) = (each for each in blades if each.shape[1] == max(b.shape[1] for b in blades))
    feet, heights_m = grass[:, 0, :2], grass[..., 2].max(axis=1)
    away = np.linalg.norm(feet - np.median(feet, axis=0), axis=1)
    within, rim = away < 0.2, (away > 0.36) & (away < 0.45)
    area_m2 = np.pi * np.array((0.2**2, 0.45**2 - 0.36**2))
    density = np.array((within.sum(), rim.sum())) / area_m2
    assert 0 < density[1] < 0.5 * density[0]
    assert np.median(heights_m[rim]) < 0.75 * np.median(heights_m[within])


@pytest.mark.parametrize("size_m", SIZES_M)
def test_petals_keep_their_sizes_in_meadows_of_any_width(size_m: float) -> None:
    plant = make_shape("flower_meadow", np.random.default_rng(4), plant_m=size_m)
    petals = {each.shape[1]: each for each in organs_of(plant, size_m)}[5]
    petals = petals[np.linalg.norm(petals[:, 4] - petals[:, 0], axis=1) > 0]
    assert_within(distance(petals, 0, 4), ORGANS["flower_meadow"]["flower"].length_m, "petal")


@pytest.mark.parametrize(
    "size_m",
    [0.3, *(pytest.param(size_m, marks=pytest.mark.long) for size_m in SIZES_M[:-1]), SIZES_M[-1]],
)
def test_succulents_dry_twigs_and_heads_of_moss_keep_their_sizes(size_m: float) -> None:
    shapes = {
        name: make_shape(name, np.random.default_rng(4), plant_m=size_m)
        for name in ("rosette", "dry_bush", "moss_cushion")
    }
    for shown_m in (size_m * CLASS_RATIO**-0.5, size_m * CLASS_RATIO**0.5):
        for name, corners, measure in (
            ("rosette", 11, half_leaf_m),
            ("dry_bush", 9, twig_m),
            ("moss_cushion", 7, head_m),
        ):
            (size,) = ORGANS[name].values()
            organs = organs_of(shapes[name], shown_m, opaque=True)
            lengths_m, widths_m = measure(next(o for o in organs if o.shape[1] == corners))
            assert_within(lengths_m, size.length_m, f"length, {name}")
            assert_within(widths_m, size.width_m, f"width, {name}")
    for plant in shapes.values():
        assert len(plant.triangles) <= SHRUB_TRIANGLES


def half_leaf_m(strips: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (N,) lengths of leaves of two strips along their midribs, and their widths.

    Of each strip, one edge is the midrib and the other bulges: it is the longer one.
    """
    edges = [strips[:, [*range(first, first + 5), 10]] for first in (0, 5)]
    lengths_m = [np.linalg.norm(np.diff(e, axis=1), axis=2).sum(axis=1) for e in edges]
    across_m = np.linalg.norm(strips[:, 5:10] - strips[:, :5], axis=2).max(axis=1)
    return np.minimum(*lengths_m), 2 * across_m


def twig_m(tubes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (N,) lengths of tubes of three triangular rings, and thicknesses at the foot."""
    rings = tubes.reshape(-1, 3, 3, 3)
    middles = rings.mean(axis=2)
    thickness_m = 2 * np.linalg.norm(rings[:, 0] - middles[:, :1], axis=2).mean(axis=1)
    lengths_m = np.linalg.norm(np.diff(middles, axis=1), axis=2).sum(axis=1)
    return lengths_m, thickness_m


def head_m(cones: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (N,) heights of cones of six sides, and their widths."""
    base = cones[:, :6].mean(axis=1)
    heights_m = np.linalg.norm(cones[:, 6] - base, axis=1)
    return heights_m, distance(cones, 0, 3)


def test_larger_bushes_cushions_and_clumps_have_more_organs() -> None:
    for name, corners in (("rosette", 11), ("dry_bush", 9), ("moss_cushion", 7)):
        counts = []
        for size_m in (0.5, 1.0, 2.0):
            plant = make_shape(name, np.random.default_rng(4), plant_m=size_m)
            organs = organs_of(plant, size_m, opaque=True)
            counts.append(sum(len(o) for o in organs if o.shape[1] == corners))
        assert counts[0] < counts[1] < counts[2], name


def test_a_groups_plants_share_meshes_with_plants_of_about_their_size() -> None:
    given = {"name": "g", "shape": "spruce", "label": "tree", "semantic_id": 10}
    group = GroupConfig.model_validate(
        given | {"count": (40, 40), "size_m": (1.0, 9.0), "spacing": 0.0}
    )
    ground = HeightField(np.zeros((9, 9), np.float32), (-40.0, -40.0), 10.0)
    shapes = PrototypeLibrary("granite", 1.0, 64, 1).group_prototypes(
        group, np.random.default_rng(1)
    )
    middles_m = size_classes_m(group)

    T_map_object, shape_of = scatter_group(group, 40, shapes, ground, np.random.default_rng(2))

    sizes_m = np.linalg.norm(T_map_object[:, :3, 0], axis=1)
    assert len(shapes) == len(middles_m) == 6
    assert (np.abs(np.log(sizes_m / middles_m[shape_of])) <= np.log(CLASS_RATIO) / 2 + 1e-6).all()
    triangles = [len(each.triangles) for each in shapes]
    assert triangles[-1] > 2 * triangles[0], "larger trees have more needles"


def test_a_placed_and_an_added_tree_have_needles_of_their_own_size() -> None:
    from oaisys_core.config import config_from_mapping
    from oaisys_core.simulation import Simulation
    from oaisys_core.types import ModuleMetadata

    tree = {"shape": "spruce", "position_m": [0, 0, 0], "label": "tree", "semantic_id": 10}
    config = config_from_mapping(
        {
            "backend": "analytic",
            "stage": {"preset": "plane", "extent_m": 20, "resolution_px": 9},
            "materials": SMALL_MATERIALS,
            "assets": {"rocks": [], "objects": [tree | {"name": "placed", "scale": 8.0}]},
        }
    )
    simulation = Simulation(config)
    try:
        simulation.step_batch()
        added = {name: tree | {"scale": scale} for name, scale in (("a", 8.0), ("b", 1.0))}
        simulation.step_sample(ModuleMetadata(asset={"add": added}), modalities=["depth"])
        scene = simulation.scene
        for placement in scene.placements:
            scale = float(np.linalg.norm(placement.T_map_object[0, :3, 0]))
            organs = organs_of(scene.prototypes[placement.prototype], scale)
            needles = next(each for each in organs if each.shape[1] == 3)
            assert_leaves(needles, ORGANS["spruce"]["leaf"], are_needles=True)
        assert len(scene.placements) == 3
    finally:
        simulation.close()


@pytest.mark.parametrize("size_m", [1.0, 3.0, 8.0, 15.0])
@pytest.mark.parametrize("name", ["spruce", "pine", "dwarf_pine", "juniper"])
def test_rows_are_shown_as_needles_of_the_width_of_the_species(name: str, size_m: float) -> None:
    """Shoots of 5 to 25 cm stand for needles, and looked like leaves of bamboo near the camera."""
    plant = make_shape(name, np.random.default_rng(4), plant_m=size_m)
    if plant.needles is None:
        (needles,) = organs_of(plant, size_m)
        assert needles.shape[1] == 3, "each needle is a triangle"
        return
    assert plant.translucency is not None
    corners = plant.vertices_m[plant.triangles].astype(np.float64) * size_m
    number = (plant.needles[plant.triangles].astype(np.float64) - 2) / 4
    is_row = (np.ptp(number, axis=1) > 0) & (plant.translucency[plant.triangles[:, 0]] > 0)
    sides = corners[is_row, 1:] - corners[is_row, :1]
    # The gradient of the number across a triangle, by which needles are apart.
    steps = number[is_row, 1:] - number[is_row, :1]
    gradient = np.einsum("nij,nj->ni", np.linalg.pinv(sides), steps)
    widths_m = 0.5 / np.linalg.norm(gradient, axis=1)
    low_m, high_m = ORGANS[name]["leaf"].width_m
    assert ((widths_m >= low_m) & (widths_m <= high_m)).mean() > 0.99
    stems = plant.translucency == 0
    assert (plant.needles[stems] == 2).all(), "stems are closed"
