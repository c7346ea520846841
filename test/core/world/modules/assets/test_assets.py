"""Groups, objects and movers in a simulation, and what metadata changes about them."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from oaisys_core import geometry
from oaisys_core.config import config_from_mapping
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.procedural.scatter.ids import (
    FAR,
    ON_LAND,
    group_blocks,
    id_of_added,
    land_blocks,
    rock_block,
)
from oaisys_core.scene import HeightField, Placement
from oaisys_core.simulation import Simulation
from oaisys_core.types import GroupCount, ModuleMetadata
from oaisys_core.world.module import World
from oaisys_core.world.modules.assets.module import AssetsModule

LABEL = {"label": "thing", "semantic_id": 30}
GRASS = {"name": "grass", "shape": "grass_tuft", "count": [20, 40], "size_m": [0.3, 0.6]} | LABEL
STONES = {"name": "stones", "shape": "pebble", "count": [50, 50], "size_m": [0.05, 0.2]} | LABEL
CRATE = {"shape": "box", "size_m": [1, 2, 1], "position_m": [0, 0, 0.5]}
LANDER = {"name": "lander", "shape": "lander", "position_m": [5, 5, 0], "on_ground": True} | LABEL
ROVER = {
    "name": "rover",
    "shape": "rover",
    "trajectory": {"waypoints_m": [[-6, -2], [6, -2]], "step_m": 1.5},
} | LABEL
ASSETS = {
    "rocks": [{"count": [5, 9], "variants": 1}],
    "primitives": [CRATE],
    "groups": [GRASS, STONES],
    "objects": [LANDER],
    "movers": [ROVER],
}
SLOPE_X, SLOPE_Y = 0.3, -0.2


def inclined() -> HeightField:
    axis = np.linspace(-20, 20, 65)
    height = SLOPE_X * axis[None, :] + SLOPE_Y * axis[:, None]
    return HeightField(height, (-20.0, -20.0), 40 / 64)


def test_rocks_can_be_as_many_as_cover_a_share_of_the_ground() -> None:
    rocks = {"cover": [0.05, 0.05], "size_m": [0.15, 1.0], "variants": 1, "max_slope_deg": 90}
    placed = Stand({"rocks": [rocks]}).world.placements
    sizes_m = np.concatenate(
        [np.linalg.norm(each.T_map_object[:, :3, 0], axis=1) for each in placed]
    )
    q = 1.79 + 0.152 / 0.05
    share = 0.05 * (np.exp(-0.15 * q) - np.exp(-1.0 * q))
    assert np.pi / 4 * (sizes_m**2).sum() / 40**2 == pytest.approx(share, rel=0.15)


def test_more_rocks_than_a_world_holds_are_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"assets.rocks\[\].size_m.*are more than 1000000"):
        Stand({"rocks": [{"cover": [0.3, 0.3], "size_m": [0.001, 1.0], "variants": 1}]})


@pytest.mark.parametrize("cover", [[0, 0.1], [0.2, 0.1], [0.1, 0.6]])
def test_a_cover_is_a_range_of_shares(cover: list[float]) -> None:
    with pytest.raises(ConfigError, match=r"assets.rocks.0.cover"):
        config_from_mapping({"assets": {"rocks": [{"cover": cover}]}})


class Stand:
    """A module with its world, stepped by hand on an inclined plane."""

    def __init__(self, assets: Mapping[str, Any], seed: int = 1, **metadata: Any) -> None:
        config = config_from_mapping({"assets": {"rocks": [], **assets}})
        self.module = AssetsModule(config.assets, 16, 0)
        self.world = World(ground=inclined())
        self.module.check(metadata)
        self.module.step_batch(self.world, metadata, np.random.default_rng(seed))

    def step(self, **metadata: Any) -> None:
        self.module.check_sample(metadata)
        self.world.sample_id += 1
        rng = np.random.default_rng(self.world.sample_id)
        self.module.step_sample(self.world, metadata or None, rng)

    @property
    def ids(self) -> list[int]:
        return sorted(i for p in self.world.placements for i in p.instance_ids.tolist())

    def pose(self, instance_id: int) -> Any:
        for placement in self.world.placements:
            row = np.flatnonzero(placement.instance_ids == instance_id)
            if len(row):
                return placement.T_map_object[row[0]]
        raise KeyError(instance_id)


def bytes_of(placements: tuple[Placement, ...]) -> list[bytes]:
    return [p.T_map_object.tobytes() + p.instance_ids.tobytes() for p in placements]


def test_ids_are_unique_and_their_labels_known() -> None:
    stand = Stand(ASSETS)
    ids = [*stand.ids, *(p.instance_id for p in stand.world.primitives)]
    assert len(set(ids)) == len(ids)
    assert min(ids) == 1
    assert stand.world.semantic_labels == {10: "rock", 20: "target", 30: "thing"}
    assert max(ids) < 2**16


def test_adding_a_group_changes_neither_ids_nor_places_of_the_others() -> None:
    few, many = Stand(ASSETS), Stand(ASSETS | {"groups": [GRASS, STONES, STONES | {"name": "new"}]})
    kept = set(few.ids)
    assert kept < set(many.ids)
    for instance_id in kept:
        assert np.array_equal(few.pose(instance_id), many.pose(instance_id))
    without = Stand(ASSETS | {"rocks": [], "primitives": []})
    for instance_id in without.ids:
        assert np.array_equal(few.pose(instance_id), without.pose(instance_id))


def test_hidden_groups_and_other_counts_leave_ids_alone() -> None:
    shown, hidden = Stand(ASSETS), Stand(ASSETS | {"groups": [GRASS | {"hidden": True}, STONES]})
    grass = {i for i in shown.ids if 10_001 <= i <= 10_040}
    assert grass
    assert set(shown.ids) - set(hidden.ids) == grass
    hidden.step(groups={"grass": {"hidden": False}})
    assert hidden.ids == shown.ids


def test_blocks_of_ids_never_meet() -> None:
    rocks = rock_block(1500)
    counts = [40, 30_000, 25_000, 900_000, 900_000, 10]
    blocks = group_blocks(rocks, counts)
    drawn = [2 * count if count < FAR // 2 else count for count in counts]
    ids = [set(block.ids(n).tolist()) for block, n in zip(blocks, drawn, strict=True)]
    on_land = land_blocks(blocks)
    ids += [set(block.ids(ON_LAND).tolist()) for block in on_land]
    blocks += on_land
    ids += [set(rocks.ids(12_000).tolist()), set(range(60_001, 65_536))]
    assert len(set().union(*ids)) == sum(len(each) for each in ids)
    assert all(b.holds(i) for b, each in zip(blocks, ids, strict=False) for i in each)
    assert max(max(each) for each in ids) < 8 * FAR


def test_ids_on_land_fit_into_images_of_16_bits_in_worlds_of_usual_size() -> None:
    blocks = land_blocks(group_blocks(rock_block(200), [2000, 40, 300]))
    assert [each.first for each in blocks] == [59_001, 58_001, 57_001]


def test_counts_say_how_many_were_asked_for_and_how_many_stand() -> None:
    full = STONES | {"name": "full", "spacing_m": 8.0}
    stand = Stand({"groups": [STONES, full]}, count_factor=2.0)
    stones, crowded = stand.world.group_counts
    assert stones == GroupCount("stones", 100, 100)
    assert (crowded.name, crowded.asked) == ("full", 100)
    assert 5 < crowded.placed < 30
    assert len(stand.ids) == stones.placed + crowded.placed


def test_rocks_without_room_are_counted() -> None:
    few = {"kind": "pebble", "count": [4, 4], "size_m": [0.1, 0.1]}
    crowded = {"kind": "boulder", "count": [300, 300], "size_m": [6.0, 6.0]}
    stand = Stand({"rocks": [few, crowded]})
    (counted,) = stand.world.group_counts
    assert (counted.name, counted.asked) == ("rocks.1", 300)
    assert len(stand.ids) == 4 + counted.placed < 304


def test_a_group_is_there_as_often_as_its_probability_says() -> None:
    assets = {"groups": [STONES | {"count": [1, 1], "variants": 1, "probability": 0.3}]}
    there = [len(Stand(assets, seed).ids) for seed in range(200)]
    assert np.mean(there) == pytest.approx(0.3, abs=0.1)


def test_counts_are_within_their_range_and_follow_factors() -> None:
    assets = {"groups": [GRASS]}
    counts = [len(Stand(assets, seed).ids) for seed in range(16)]
    assert 20 <= min(counts) < 26 < 34 < max(counts) <= 40
    doubled = Stand(assets, 3, groups={"grass": {"count_factor": 2}})
    assert len(doubled.ids) == 2 * counts[3]
    halved = Stand(assets, 3, count_factor=0.5)
    assert len(halved.ids) == round(0.5 * counts[3])


def test_equal_seeds_give_equal_worlds() -> None:
    one, two, other = Stand(ASSETS, 1), Stand(ASSETS, 1), Stand(ASSETS, 2)
    assert bytes_of(one.world.placements) == bytes_of(two.world.placements)
    assert bytes_of(one.world.placements) != bytes_of(other.world.placements)


def test_a_mover_stands_on_the_plane_at_each_sample() -> None:
    stand = Stand({"movers": [ROVER]})
    up = np.array((-SLOPE_X, -SLOPE_Y, 1.0)) / np.sqrt(1 + SLOPE_X**2 + SLOPE_Y**2)
    for sample_id in range(12):
        T = stand.pose(62_501)
        x, y = min(-6 + 1.5 * sample_id, 6.0), -2.0
        assert T[:3, 3] == pytest.approx((x, y, SLOPE_X * x + SLOPE_Y * y), abs=1e-6)
        assert T[:3, 2] == pytest.approx(up, abs=1e-6)
        assert np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3))
        assert T[0, 0] > 0.9, "its x axis is ahead"
        stand.step()


def test_a_mover_that_rests_stays_the_same_object() -> None:
    stand = Stand({"movers": [ROVER], "groups": [GRASS]})
    stand.step()
    before = stand.world.placements
    stand.step()
    assert [a is b for a, b in zip(before, stand.world.placements, strict=True)] == [
        *(True for _ in before[:-1]),
        False,
    ]
    assert before[-1].is_moving
    for _ in range(10):
        stand.step()
    before = stand.world.placements
    stand.step()
    assert stand.world.placements is before


def test_a_closed_way_leads_back_and_a_smooth_one_through_its_points() -> None:
    square = [[0, 0], [4, 0], [4, 4], [0, 4]]
    way = {"waypoints_m": square, "closed": True, "step_m": 2.0}
    stand = Stand({"movers": [ROVER | {"trajectory": way}]})
    positions = [stand.pose(62_501)[:2, 3]]
    for _ in range(8):
        stand.step()
        positions.append(stand.pose(62_501)[:2, 3])
    assert positions[8] == pytest.approx(positions[0])
    assert positions[3] == pytest.approx((4, 2))
    smooth = Stand({"movers": [ROVER | {"trajectory": way | {"smooth": True, "step_m": 0.05}}]})
    found = []
    for _ in range(400):
        smooth.step()
        found.append(smooth.pose(62_501)[:2, 3])
    for corner in square:
        assert np.linalg.norm(np.array(found) - corner, axis=1).min() < 0.03


def test_a_mover_follows_a_csv_file_in_all_six_degrees(tmp_path: Path) -> None:
    rows = ["x_m,y_m,z_m,qx,qy,qz,qw", "1,2,3,0,0,0,1", "4,5,6,0,0,1,0"]
    (tmp_path / "way.csv").write_text("\n".join(rows))
    trajectory = {"csv": str(tmp_path / "way.csv")}
    mover = ROVER | {"trajectory": trajectory, "on_ground": False, "scale": 2.0}
    stand = Stand({"movers": [mover]})
    assert stand.pose(62_501) == pytest.approx(
        geometry.transform(2 * np.eye(3), (1, 2, 3)), abs=1e-12
    )
    for _ in range(2):
        stand.step()
        turned = geometry.transform(2 * np.diag((-1.0, -1.0, 1.0)), (4, 5, 6))
        assert stand.pose(62_501) == pytest.approx(turned, abs=1e-9)


def test_an_object_on_the_ground_counts_its_height_from_there() -> None:
    stand = Stand({"objects": [LANDER | {"position_m": [5, -3, 0.5], "scale": 0.5}]})
    T = stand.pose(60_001)
    assert T[:3, 3] == pytest.approx((5, -3, 5 * SLOPE_X - 3 * SLOPE_Y + 0.5))
    assert np.allclose(T[:3, :3], 0.5 * np.eye(3))


def test_samples_move_turn_rescale_and_hide_things() -> None:
    stand = Stand(ASSETS)
    drawn_at, drawn = stand.pose(10_041), stand.world.placements
    half = np.sqrt(0.5)
    stand.step(objects={"10041": {"position_m": [1, 2, 3], "scale": 2.0}})
    T = stand.pose(10_041)
    assert T[:3, 3].tolist() == [1, 2, 3]
    assert np.allclose(T[:3, :3], 2 * drawn_at[:3, :3])
    changed = [a is not b for a, b in zip(drawn, stand.world.placements, strict=True)]
    assert sum(changed) == 2, "the stone's placement and the rover's"
    stand.step(objects={"10041": {"quat_xyzw": [0, 0, half, half]}})
    size = np.linalg.norm(drawn_at[:3, 0])
    R = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    assert np.allclose(stand.pose(10_041)[:3, :3], 2 * size * np.array(R))
    assert stand.pose(10_041)[:3, 3].tolist() == [1, 2, 3], "changes add up"
    stand.step(objects={"10041": {"hidden": True}})
    assert 10_041 not in stand.ids
    stand.step(objects={"10041": None})
    assert np.array_equal(stand.pose(10_041), drawn_at), "null is as it was drawn"


def test_exact_solids_and_movers_can_be_changed_too() -> None:
    stand = Stand({"primitives": [CRATE], "movers": [ROVER]})
    stand.step(objects={"1": {"scale": 2.0}, "62501": {"position_m": [9, 9, 9]}})
    (crate,) = stand.world.primitives
    assert list(crate.size_m) == [2, 4, 2]
    stand.step()
    assert stand.pose(62_501)[:3, 3].tolist() == [9, 9, 9]
    stand.step(objects={"1": {"hidden": True}})
    assert not stand.world.primitives


def test_groups_can_be_rescaled() -> None:
    stand = Stand(ASSETS)
    before = stand.pose(10_041)
    stand.step(groups={"stones": {"scale": 3.0}})
    assert np.allclose(stand.pose(10_041)[:3, :3], 3 * before[:3, :3])


def test_things_are_added_by_name_and_go_with_null() -> None:
    stand = Stand(ASSETS)
    before = stand.ids
    stone = {"shape": "boulder", "position_m": [1, 1, 0], "label": "mark", "semantic_id": 77}
    stand.step(add={"mark-1": stone, "mark-2": stone | {"prototype": "stones", "shape": None}})
    assert sorted({*stand.ids} - {*before}) == sorted(
        [id_of_added("mark-1"), id_of_added("mark-2")]
    )
    assert stand.world.semantic_labels[77] == "mark"
    first = stand.world.placements[-2]
    stand.step(add={"mark-2": {"position_m": [2, 2, 0]}})
    assert stand.world.placements[-2] is first
    assert stand.pose(id_of_added("mark-2"))[:3, 3].tolist() == [2, 2, 0]
    stand.step(add={"mark-1": None, "mark-2": None})
    assert stand.ids == before
    assert 77 not in stand.world.semantic_labels


@pytest.mark.parametrize(
    ("metadata", "path"),
    [
        ({"objects": {"17000": {"scale": 1}}}, "objects.17000"),
        ({"objects": {"1": {"scale": 0}}}, "objects.1.scale"),
        ({"objects": {"1": {"colour": 3}}}, "objects.1.colour"),
        ({"objects": {"1": {"quat_xyzw": [0, 0, 0, 2]}}}, "objects.1.quat_xyzw"),
        ({"objects": {"one": {}}}, "objects.one"),
        ({"groups": {"moss": {}}}, "groups.moss"),
        ({"groups": {"grass": {"count_factor": 1.5}}}, "groups.grass.count_factor"),
        ({"count_factor": 1.5}, "count_factor"),
        ({"remove": ["x"]}, "remove"),
        ({"add": {"x": {"shape": "cube", "position_m": [0, 0, 0]} | LABEL}}, "add.x.shape"),
        ({"add": {"x": {"position_m": [0, 0, 0]} | LABEL}}, "add.x"),
        ({"add": {"x": {"shape": "slab"} | LABEL}}, "add.x.position_m"),
        ({"add": {"x": LANDER | {"name": "x"}}}, "add.x.name"),
        ({"add": {"x": {"prototype": "moss", "position_m": [0, 0, 0]} | LABEL}}, "add.x.prototype"),
        ({"add": {"x": {"file": "none.obj", "position_m": [0, 0, 0]} | LABEL}}, "add.x.file"),
        (
            {
                "add": {
                    "x": {"shape": "slab", "position_m": [0, 0, 0], "label": "a"}
                    | {"semantic_id": 30}
                }
            },
            "add.x.label",
        ),
        (
            {"add": {"x": {"shape": "slab", "position_m": [90, 0, 0], "on_ground": True} | LABEL}},
            "add.x.position_m",
        ),
    ],
)
def test_what_cannot_be_applied_is_refused_and_changes_nothing(
    metadata: dict[str, Any], path: str
) -> None:
    stand = Stand(ASSETS)
    before = replace(stand.world)
    with pytest.raises(InvalidInputError) as refusal:
        stand.module.check_sample(metadata)
    assert refusal.value.field == f"metadata.asset.{path}"
    assert stand.world == before


@pytest.mark.parametrize(
    ("assets", "path"),
    [
        ({"groups": [STONES | {"shape": "cube"}]}, "assets.groups.0.shape"),
        ({"groups": [STONES | {"texture": "velvet"}]}, "assets.groups.0.texture"),
        ({"groups": [STONES, STONES]}, "stones"),
        ({"groups": [STONES | {"count": [3, 2]}]}, "groups.0.count"),
        ({"objects": [LANDER | {"file": "lander.obj"}]}, "objects.0"),
        ({"movers": [ROVER | {"trajectory": {"waypoints_m": [[0, 0]]}}]}, "movers.0.trajectory"),
        ({"objects": [LANDER | {"label": "rock2", "semantic_id": 10}]}, "semantic_id 10"),
        ({"groups": [STONES | {"density": [{"kind": "moon"}]}]}, "groups.0.density.0"),
    ],
)
def test_configurations_that_cannot_be_are_refused(assets: dict[str, Any], path: str) -> None:
    with pytest.raises(ConfigError, match=path.replace(".", r"\.")):
        Simulation(config_from_mapping({"backend": "analytic", "assets": assets}))


def test_a_users_mesh_is_scaled_for_a_group_and_kept_for_an_object(tmp_path: Path) -> None:
    corners = ["v 2 0 0 1 0 0", "v 6 0 0 1 0 0", "v 2 2 0 0 1 0", "v 2 0 1 0 0 1"]
    faces = ["f 1 3 2", "f 1 2 4", "f 2 3 4", "f 3 1 4"]
    (tmp_path / "wedge.obj").write_text("\n".join(corners + faces))
    file = {"file": str(tmp_path / "wedge.obj")}
    group = {"name": "wedges", "count": [3, 3]} | file | LABEL
    thing = {"name": "wedge", "position_m": [0, 0, 0], "anchor": "origin"} | file | LABEL
    turned = thing | {"name": "turned", "up_axis": "y"}
    stand = Stand({"groups": [group], "objects": [thing, turned]})
    scattered, kept, upright = (stand.world.prototypes[p.prototype] for p in stand.world.placements)
    assert np.ptp(scattered.vertices_m, axis=0) == pytest.approx((1, 0.5, 0.25))
    assert scattered.vertices_m[:, 2].min() == 0
    assert kept.vertices_m.min(axis=0) == pytest.approx((2, 0, 0))
    assert np.ptp(upright.vertices_m, axis=0) == pytest.approx((4, 1, 2))
    assert kept.vertex_colors_srgb is not None


def test_a_users_mesh_of_1_m_stands_at_its_place_wherever_its_file_has_it(tmp_path: Path) -> None:
    """One that was 1 m large already stood where its file had it: beside its place."""
    corners = ["v 2 0 0", "v 3 0 0", "v 2 1 0", "v 2 0 1"]
    faces = ["f 1 3 2", "f 1 2 4", "f 2 3 4", "f 3 1 4"]
    (tmp_path / "wedge.obj").write_text("\n".join(corners + faces))
    group = {"name": "wedges", "count": [1, 1], "file": str(tmp_path / "wedge.obj")} | LABEL
    stand = Stand({"groups": [group]})
    look = stand.world.prototypes[stand.world.placements[0].prototype]
    low, high = look.vertices_m.min(axis=0), look.vertices_m.max(axis=0)
    assert (*(low + high)[:2] / 2, low[2]) == pytest.approx((0, 0, 0), abs=1e-6)


def test_a_restored_simulation_goes_on_as_the_first_would_have() -> None:
    config = config_from_mapping(
        {
            "backend": "analytic",
            "stage": {
                "surroundings": "plain",
                "preset": "mounds",
                "extent_m": 30.0,
                "resolution_px": 65,
            },
            "materials": {"texture_size_px": 16, "mask": {"size_px": 16, "relief": 0}},
            "assets": ASSETS,
            "sensors": {
                "cameras": [{"width_px": 32, "height_px": 24, "fx_px": 20, "fy_px": 20}],
                "pose_policy": "allow",
            },
        }
    )
    pose = geometry.pose_looking_down(0.0, 0.0, 14.0)

    def sample(simulation: Simulation, **asset: Any) -> list[bytes]:
        metadata = ModuleMetadata(sensor={"pose": pose}, asset=asset or None)
        return [frame.data.tobytes() for frame in simulation.step_sample(metadata).frames]

    first = Simulation(config)
    first.step_batch(ModuleMetadata(asset={"groups": {"stones": {"count_factor": 2}}}))
    sample(first, objects={"62501": {"scale": 2.0}, "10041": {"position_m": [0, 0, 3]}})
    sample(first, add={"x": {"shape": "slab", "position_m": [1, 1, 3]} | LABEL})
    second = Simulation(config)
    second.restore(json.loads(json.dumps(first.state())))
    points = [[x, -2.0, 9.0] for x in np.linspace(-8, 8, 33)]
    mine, theirs = (each.query_height(points).surface_height_m for each in (first, second))
    assert np.allclose(mine, theirs, rtol=0, atol=1e-9)
    assert sample(second) == sample(first)
    gone = {"x": None}
    assert sample(second, add=gone) == sample(first, add=gone)
