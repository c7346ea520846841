"""The things of a world as a client lists them: filtered, a page at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from served_simulator import FLAT_WORLD, Server

from oaisys_core.errors import InvalidInputError, NotReadyError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import MAX_OBJECTS, ModuleMetadata, ObjectQuery
from oaisys_grpc.client.simulator_client import SimulatorClient

StartServer = Callable[..., Server]

WORLD: dict[str, Any] = {
    **FLAT_WORLD,
    "assets": {
        "rocks": [{"kind": "angular", "count": [30, 30], "size_m": [0.3, 0.6]}],
        "primitives": [{"shape": "box", "size_m": [2, 4, 1], "position_m": [5, 0, 0.5]}],
        "groups": [
            {"name": "stones", "shape": "rounded", "count": [20, 20], "size_m": [0.2, 0.4]}
            | {"label": "stone", "semantic_id": 11}
        ],
        "objects": [
            {"name": "mark", "shape": "boulder", "position_m": [-6, 2, 0], "scale": 2.0}
            | {"label": "mark", "semantic_id": 12}
        ],
    },
}
BOULDER = {"shape": "boulder", "position_m": [3, 3, 0], "label": "extra", "semantic_id": 13}


def true_vertices_m(client: SimulatorClient, instance_id: int) -> np.ndarray:
    """Return the (N, 3) vertices in `map` of an object in the true mesh."""
    mesh = client.ground_truth_mesh()
    assert mesh.instance_ids is not None
    return mesh.vertices_m[np.unique(mesh.triangles[mesh.instance_ids == instance_id])]


def adding(name: str, **changes: Any) -> ModuleMetadata:
    return ModuleMetadata(asset={"add": {name: {**BOULDER, **changes}}})


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatorClient]:
    """A client of a server with things; before the first batch there are none to list."""
    folder = tmp_path_factory.mktemp("objects") / "server"
    with Server(folder, WORLD) as server, server.client() as client:
        with pytest.raises(NotReadyError):
            client.list_objects()
        client.step_batch()
        yield client


def names(
    client: SimulatorClient, metadata: ModuleMetadata | None = None, **query: Any
) -> list[str]:
    return [thing.name for thing in client.list_objects(ObjectQuery(**query), metadata).objects]


def test_an_objects_own_box_is_the_one_around_its_mesh(client: SimulatorClient) -> None:
    kinds = {thing.kind: thing for thing in client.list_objects().objects}
    assert len(kinds) == 4
    for thing in kinds.values():
        vertices_m = true_vertices_m(client, thing.instance_id)
        turn = Rotation.from_quat(thing.pose.quat_xyzw)
        own_m = turn.inv().apply(vertices_m - np.array(thing.pose.position_m))
        assert_allclose(own_m.min(axis=0), thing.box_low_m, atol=1e-4)
        assert_allclose(own_m.max(axis=0), thing.box_high_m, atol=1e-4)


def test_everything_is_listed_once_in_the_order_of_its_ids(client: SimulatorClient) -> None:
    page = client.list_objects()
    assert (page.total, page.next_after_instance_id) == (52, 0)
    ids = [thing.instance_id for thing in page.objects]
    assert ids == sorted(set(ids))
    assert len({thing.name for thing in page.objects}) == 52
    kinds = [thing.kind for thing in page.objects]
    assert [kinds.count(k) for k in ("rock", "solid", "group", "object")] == [30, 1, 20, 1]
    (mark,) = client.list_objects(ObjectQuery(names=("mark",))).objects
    assert (mark.kind, mark.label, mark.semantic_id) == ("object", "mark", 12)
    assert_allclose((*mark.pose.position_m, mark.scale), (-6, 2, 0, 2))
    (box,) = client.list_objects(ObjectQuery(kinds=("solid",))).objects
    assert_allclose((box.low_m, box.high_m), ((4, -2, 0), (6, 2, 1)))
    assert {thing.label for thing in page.objects} == {"rock", "target", "stone", "mark"}


def test_a_list_says_where_what_is_seen_is(client: SimulatorClient) -> None:
    """The instance image is the judge: every id in it is listed, inside its box."""
    sample = client.render_sample(pose_looking_down(0, 0, 15))
    ids = np.unique(sample.frame("camera", "instance").data)
    seen = tuple(int(i) for i in ids if i)
    assert len(seen) > 5
    page = client.list_objects(ObjectQuery(instance_ids=seen))
    assert tuple(thing.instance_id for thing in page.objects) == seen
    depth_m, instance = (sample.frame("camera", m).data for m in ("depth", "instance"))
    for thing in page.objects:
        at = instance == thing.instance_id
        z_m = 15 - depth_m[at]
        low_m, high_m = np.array(thing.low_m) - 1e-3, np.array(thing.high_m) + 1e-3
        assert ((z_m >= low_m[2]) & (z_m <= high_m[2])).all(), thing
        assert (np.array(thing.low_m) <= thing.high_m).all()


def test_pages_and_filters_bound_what_is_sent(client: SimulatorClient) -> None:
    everything = names(client)
    read: list[str] = []
    after = 0
    for _ in range(6):
        page = client.list_objects(ObjectQuery(limit=10, after_instance_id=after))
        assert page.total == 52
        read += [thing.name for thing in page.objects]
        after = page.next_after_instance_id
    assert (read, after) == (everything, 0)
    assert len(names(client, groups=("stones",))) == 20
    inside = client.list_objects(ObjectQuery(low_m=(-7, 1, -1), high_m=(-5, 3, 1))).objects
    assert "mark" in [thing.name for thing in inside]
    for thing in inside:
        x, y, _ = thing.pose.position_m
        assert -7 <= x <= -5
        assert 1 <= y <= 3
    assert names(client, names=("mark", "nobody", everything[3], "rock_1")) == [
        everything[3],
        "mark",
    ]
    for wrong, field in (
        ({"kinds": ("tree",)}, "kinds"),
        ({"limit": MAX_OBJECTS + 1}, "limit"),
        ({"low_m": (float("nan"), 0, 0)}, "low_m"),
    ):
        with pytest.raises(InvalidInputError) as refused:
            client.list_objects(ObjectQuery(**wrong))
        assert refused.value.field == field


def test_what_metadata_would_bring_is_listed_and_checked_but_not_done(
    client: SimulatorClient,
) -> None:
    pose = pose_looking_down(3, 3, 6)
    before = client.render_sample(pose).frame("camera", "instance").data
    rock = client.list_objects(ObjectQuery(kinds=("rock",), limit=1)).objects[0]
    later = adding("extra")
    moved = {
        "objects": {str(rock.instance_id): {"position_m": [1, 1, 0]}, "60001": {"hidden": True}}
    }
    later = later.with_update(ModuleMetadata(asset=moved))
    (extra,) = client.list_objects(ObjectQuery(kinds=("added",)), later).objects
    assert (extra.name, extra.label, extra.pose.position_m) == ("extra", "extra", (3, 3, 0))
    (rock_later,) = client.list_objects(ObjectQuery(names=(rock.name,)), later).objects
    assert_allclose(rock_later.pose.position_m, (1, 1, 0))
    assert names(client, later, names=("mark",)) == []
    with pytest.raises(InvalidInputError, match="shape"):
        client.list_objects(metadata=adding("extra", shape="castle"))

    assert names(client, kinds=("added",)) == []
    assert names(client, names=("mark",)) == ["mark"]
    assert np.array_equal(client.render_sample(pose).frame("camera", "instance").data, before)
    sample = client.render_sample(pose, metadata=later)
    assert extra.instance_id in sample.frame("camera", "instance").data
    assert names(client, kinds=("added",)) == ["extra"]
    client.render_sample(pose, metadata=ModuleMetadata(asset={"add": {"extra": None}}))
    assert names(client, kinds=("added",)) == []


@pytest.mark.long
def test_twenty_thousand_stones_are_read_in_bounded_pages(start_server: StartServer) -> None:
    stones: dict[str, Any] = {"name": "gravel", "shape": "rounded", "count": [20_000, 20_000]}
    stones |= {"size_m": [0.02, 0.05], "label": "stone", "semantic_id": 11, "spacing_m": 0.0}
    world = {**FLAT_WORLD, "assets": {"rocks": [], "groups": [stones]}}
    with start_server(world).client() as client:
        client.step_batch()
        page = client.list_objects(ObjectQuery(limit=MAX_OBJECTS))
        assert len(page.objects) == MAX_OBJECTS
        assert page.total > 18_000
        assert page.next_after_instance_id == page.objects[-1].instance_id
        near = client.list_objects(ObjectQuery(low_m=(0, 0, -1), high_m=(3, 3, 1)))
        assert 20 < near.total == len(near.objects) < 500
