"""simulation_interfaces between a real server and a user."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import simulation_interfaces.srv as srv
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import Vector3
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_peer import Stage, User, stamped
from sensor_msgs.msg import Image
from served_simulator import FLAT_WORLD, ROCKY_WORLD
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import (
    Bounds,
    EntityCategory,
    EntityFilters,
    EntityState,
    Resource,
    Result,
    SimulationState,
    SimulatorFeatures,
    TagsFilter,
)
from std_msgs.msg import Header

from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.types import Pose
from oaisys_core.world.modules.sensors import START_HEIGHT_M
from oaisys_msgs.msg import SampleInfo
from oaisys_msgs.srv import SetPose, StepBatch
from oaisys_ros_bridge.conversions import image_from_msg
from oaisys_ros_bridge.parameters.bridge import BRIDGE
from oaisys_ros_bridge.qos import SENSOR_QOS, SMALL_MESSAGE_QOS

pytestmark = pytest.mark.ros

SAMPLES = "oaisys_bridge/sample_info"
DEPTH = "camera/depth/image_raw"
INSTANCE = "camera/instance/image_raw"
PLAYING, PAUSED = SimulationState.STATE_PLAYING, SimulationState.STATE_PAUSED
STOPPED, QUITTING = SimulationState.STATE_STOPPED, SimulationState.STATE_QUITTING
MOUNT_M = (0.3, -0.2, 0.1)
MOUNTED = {**FLAT_WORLD["sensors"]["cameras"][0], "mount_position_m": MOUNT_M}


class Simulator:
    """The services as methods that return a result code, a message and the answer."""

    def __init__(self, user: User) -> None:
        self.user = user

    def call(self, type_name: str, **fields: Any) -> tuple[int, str, Any]:
        kind = getattr(srv, type_name)
        name = "".join("_" + c.lower() if c.isupper() else c for c in type_name)[1:]
        answer = self.user.call(kind, name, kind.Request(**fields))
        return answer.result.result, answer.result.error_message, answer

    def set_state(self, state: int) -> tuple[int, str, Any]:
        return self.call("SetSimulationState", state=SimulationState(state=state))

    def state(self) -> int:
        code, message, answer = self.call("GetSimulationState")
        assert code == Result.RESULT_OK, message
        return int(answer.state.state)

    def put(self, entity: str, pose: Pose, **fields: Any) -> tuple[int, str, Any]:
        state = EntityState(header=Header(frame_id="map"), pose=stamped(pose).pose)
        asked: dict[str, Any] = {"state": state, "set_pose": True, **fields}
        return self.call("SetEntityState", entity=entity, **asked)

    def position(self, entity: str) -> list[float]:
        code, message, answer = self.call("GetEntityState", entity=entity)
        assert code == Result.RESULT_OK, message
        p = answer.state.pose.position
        return [p.x, p.y, p.z]

    def entities(self, **filters: Any) -> list[str]:
        code, message, answer = self.call("GetEntities", filters=EntityFilters(**filters))
        assert code == Result.RESULT_OK, message
        return list(answer.entities)


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder whose meshes can be spawned."""
    return tmp_path_factory.mktemp("meshes")


@pytest.fixture(scope="module")
def shared_simulator(shared_stage: Stage, meshes: Path) -> Simulator:
    """A simulator with things, which no test may end."""
    return started(shared_stage, THINGS, "--asset-root", str(meshes))


@pytest.fixture
def simulator(shared_simulator: Simulator) -> Simulator:
    """That simulator, with a new world and nothing received."""
    assert shared_simulator.call("ResetSimulation", scope=0)[0] == Result.RESULT_OK
    for topic in (SAMPLES, DEPTH, INSTANCE):
        shared_simulator.user.received[topic].clear()
    return shared_simulator


def started(stage: Stage, world: dict[str, Any], *options: str) -> Simulator:
    server = stage.start_world(world, *options)
    stage.user.listen(SampleInfo, SAMPLES, SMALL_MESSAGE_QOS)
    stage.user.listen(Image, DEPTH, SENSOR_QOS)
    stage.user.listen(Image, INSTANCE, SENSOR_QOS)
    stage.start_bridge(server.address)
    stage.user.wait_until_ready()
    return Simulator(stage.user)


def down(height_m: float) -> Pose:
    return pose_looking_down(0.0, 0.0, height_m)


def box(*corners: Sequence[float], kind: int = Bounds.TYPE_BOX) -> Bounds:
    points = [Vector3(x=float(x), y=float(y), z=float(z)) for x, y, z in corners]
    return Bounds(type=kind, points=points)


def test_a_simulation_is_paused_stepped_and_played(simulator: Simulator) -> None:
    user = simulator.user
    samples = user.received[SAMPLES]
    assert simulator.state() == PLAYING
    code, message, _ = simulator.call("StepSimulation", steps=1)
    assert (code, "playing" in message) == (Result.RESULT_OPERATION_FAILED, True)
    assert user.set_pose(down(5)).success

    assert simulator.set_state(PAUSED)[0] == Result.RESULT_OK
    assert simulator.set_state(PAUSED)[0] == srv.SetSimulationState.Response.ALREADY_IN_TARGET_STATE
    answer = user.set_pose(down(6))
    assert (answer.success, "paused" in answer.message) == (False, True)
    assert simulator.put("base_link", down(7))[0] == Result.RESULT_OK
    assert simulator.position("base_link") == [0, 0, 7]
    assert len(samples) == 1
    assert simulator.call("StepSimulation", steps=0)[0] == Result.RESULT_OPERATION_FAILED
    assert simulator.call("StepSimulation", steps=3)[0] == Result.RESULT_OK

    user.wait_until(lambda: len(samples) == 4)
    assert [(s.sample_id, s.rig_pose.position.z) for s in samples[1:]] == [(2, 7), (3, 7), (4, 7)]
    assert simulator.state() == PAUSED
    client = user.action_client(SimulateSteps, "oaisys_bridge/simulate_steps")
    feedback: list[tuple[int, int]] = []
    sent = client.send_goal_async(
        SimulateSteps.Goal(steps=3),
        lambda m: feedback.append((m.feedback.completed_steps, m.feedback.remaining_steps)),
    )
    goal = user.answer(sent)
    # A client of rclpy passes no feedback on once it has the result.
    user.wait_until(lambda: len(feedback) == 3)
    done = user.answer(goal.get_result_async())
    assert (done.status, done.result.result.result) == (GoalStatus.STATUS_SUCCEEDED, 1)
    assert feedback == [(1, 2), (2, 1), (3, 0)]

    assert simulator.set_state(PLAYING)[0] == Result.RESULT_OK
    assert user.set_pose(down(8)).sample_id == 8
    goal = user.answer(client.send_goal_async(SimulateSteps.Goal(steps=1)))
    failed = user.answer(goal.get_result_async())
    assert failed.status == GoalStatus.STATUS_ABORTED
    assert "playing" in failed.result.result.error_message
    code, message, _ = simulator.set_state(SimulationState.STATE_NO_WORLD)
    assert (code, "4" in message) == (srv.SetSimulationState.Response.INCORRECT_TRANSITION, True)


@pytest.mark.long
def test_entities_are_found_asked_and_put_somewhere(stage: Stage) -> None:
    simulator = started(stage, {**FLAT_WORLD, "sensors": {"cameras": [MOUNTED]}})
    assert simulator.entities() == ["base_link", "camera"]
    assert simulator.position("base_link") == pytest.approx([0, 0, START_HEIGHT_M])
    code, message, _ = simulator.call("GetEntityState", entity="rover")
    assert (code, "base_link, camera" in message) == (Result.RESULT_NOT_FOUND, True)

    level = Pose((1.0, 2.0, 5.0), (0.0, 0.0, 0.0, 1.0))
    assert simulator.put("base_link", level)[0] == Result.RESULT_OK
    assert simulator.position("base_link") == [1, 2, 5]
    assert simulator.position("camera") == pytest.approx(np.add([1, 2, 5], MOUNT_M))
    stage.user.wait_until(lambda: len(stage.user.received[SAMPLES]) == 1)
    assert simulator.put("camera", level)[0] == Result.RESULT_OK
    assert simulator.position("base_link") == pytest.approx(np.subtract([1, 2, 5], MOUNT_M))

    invalid = srv.SetEntityState.Response.INVALID_POSE
    for pose in (Pose((0, 0, 3), (0, 0, 0, 0)), Pose((0, 0, float("nan")), (0, 0, 0, 1)), down(-2)):
        code, message, _ = simulator.put("base_link", pose)
        assert (code, bool(message)) == (invalid, True)
    moving = EntityState()
    moving.twist.linear.x = 1.0
    code, message, _ = simulator.put("base_link", level, state=moving, set_twist=True)
    assert (code, "twist" in message) == (Result.RESULT_OPERATION_FAILED, True)
    assert simulator.position("base_link") == pytest.approx(np.subtract([1, 2, 5], MOUNT_M))

    robots = [EntityCategory(category=EntityCategory.CATEGORY_ROBOT)]
    assert simulator.entities(categories=robots) == ["base_link"]
    assert simulator.entities(filter="^cam[[:alpha:]]+$") == ["camera"]
    assert simulator.entities(tags=TagsFilter(tags=["depth", "rig"])) == ["base_link", "camera"]
    both = TagsFilter(tags=["depth", "sensor"], filter_mode=TagsFilter.FILTER_MODE_ALL)
    assert simulator.entities(tags=both) == ["camera"]
    around_camera = box((1, 2, 5), (0.01, 0, 0), kind=Bounds.TYPE_SPHERE)
    assert simulator.entities(bounds=around_camera) == ["camera"]
    assert simulator.entities(bounds=box((2, 3, 6), (0, 0, 0))) == ["base_link", "camera"]
    hull = EntityFilters(bounds=box((0, 0, 0), (1, 0, 0), (0, 1, 0), kind=Bounds.TYPE_CONVEX_HULL))
    assert simulator.call("GetEntities", filters=hull)[0] == Result.RESULT_FEATURE_UNSUPPORTED
    # Whatever the other filters let through: they ended the bridge.
    rig = TagsFilter(tags=["x"])
    for bounds in (Bounds(type=255), box((0, 0, 0)), box((0, 0, 0), (np.nan, 0, 0))):
        for name in ("GetEntities", "GetEntitiesStates"):
            code, message, _ = simulator.call(name, filters=EntityFilters(bounds=bounds, tags=rig))
            assert code != Result.RESULT_OK
            assert "filters.bounds" in message
    slow = EntityFilters(filter="(.|.|.|.|.|.|.|.|.|.|.|.|.|.|.|.|.|.)*!")
    assert simulator.call("GetEntities", filters=slow)[0] == Result.RESULT_OK
    wrong = EntityFilters(filter="cam(")
    assert simulator.call("GetEntitiesStates", filters=wrong)[0] == Result.RESULT_OPERATION_FAILED
    code, _, answer = simulator.call("GetEntitiesStates", filters=EntityFilters(filter="base"))
    assert (code, list(answer.entities), len(answer.states)) == (1, ["base_link"], 1)
    assert answer.states[0].header.frame_id == "map"
    assert "sensor" in simulator.call("GetEntityInfo", entity="camera")[2].info.tags
    assert simulator.set_state(QUITTING)[0] == Result.RESULT_OK
    stage.user.wait_until_ready(False)


@pytest.mark.long
def test_worlds_are_loaded_and_begun_again_with_the_same_bytes(stage: Stage) -> None:
    simulator = started(stage, ROCKY_WORLD)
    user = stage.user
    pose = pose_looking_at((6.0, 0.0, 5.0), (0.0, 0.0, 0.0))

    def depth_of_next(answer: SetPose.Response) -> bytes:
        assert answer.success, answer.message
        images = user.received[DEPTH]
        user.wait_until(lambda: images and images[-1].header.stamp == answer.stamp)
        return image_from_msg(images[-1]).tobytes()

    first = depth_of_next(user.set_pose(pose))
    world = simulator.call("GetCurrentWorld")[2].world
    assert world.world_resource.uri.startswith("oaisys:")

    assert simulator.call("ResetSimulation", scope=0)[0] == Result.RESULT_OK
    again = user.set_pose(pose)
    assert (again.batch_id, again.sample_id) == (2, 1)
    assert depth_of_next(again) == first
    code, message, _ = simulator.call("ResetSimulation", scope=4)
    assert (code, "scope" in message) == (Result.RESULT_FEATURE_UNSUPPORTED, True)

    other = Resource(resource_string=json.dumps({"seed": 7, "metadata": {"asset": {}}}))
    code, message, answer = simulator.call("LoadWorld", world_resource=other)
    assert code == Result.RESULT_OK, message
    assert (answer.world.world_resource.uri, simulator.state()) == ("oaisys:7", STOPPED)
    assert simulator.set_state(PLAYING)[0] == Result.RESULT_OK
    seventh = depth_of_next(user.set_pose(pose))
    assert seventh != first
    stepped = user.call(StepBatch, "step_batch", StepBatch.Request(seed=7))
    assert stepped.batch_id == 4
    assert depth_of_next(user.set_pose(pose)) == seventh
    code, message, _ = simulator.call("LoadWorld", world_resource=world.world_resource)
    assert code == Result.RESULT_OK, message
    assert simulator.set_state(PLAYING)[0] == Result.RESULT_OK
    assert depth_of_next(user.set_pose(pose)) == first

    codes = srv.LoadWorld.Response
    for resource, expected in (
        (Resource(), codes.NO_RESOURCE),
        (Resource(uri="file:///world.sdf"), codes.UNSUPPORTED_FORMAT),
        (Resource(resource_string="<sdf/>"), codes.RESOURCE_PARSE_ERROR),
        (Resource(resource_string='{"seed": -1}'), codes.RESOURCE_PARSE_ERROR),
    ):
        code, message, _ = simulator.call("LoadWorld", world_resource=resource)
        assert (code, bool(message)) == (expected, True)
    worlds = simulator.call("GetAvailableWorlds")[2].worlds
    assert [w.world_resource.uri for w in worlds] == [world.world_resource.uri, "oaisys:next"]


def test_what_is_not_supported_says_so(simulator: Simulator) -> None:
    kind = srv.GetSimulatorFeatures
    answer = simulator.user.call(kind, "get_simulator_features", kind.Request())
    features = set(answer.features.features)
    supported = ("STEP_SIMULATION_ACTION", "WORLD_LOADING", "ENTITY_STATE_SETTING")
    for name in (*supported, "SPAWNING", "SPAWNING_RESOURCE_STRING", "DELETING"):
        assert getattr(SimulatorFeatures, name) in features
    assert set(answer.features.spawn_formats) == {"obj", "glb", "ply", "blend", "json"}
    for missing in ("WORLD_UNLOADING", "SIMULATION_RESET_TIME", "SIMULATION_RESET_SPAWNED"):
        assert getattr(SimulatorFeatures, missing) not in features
    scope = srv.ResetSimulation.Request.SCOPE_TIME
    code, message, _ = simulator.call("ResetSimulation", scope=scope)
    assert (code, bool(message)) == (Result.RESULT_FEATURE_UNSUPPORTED, True)


THINGS: dict[str, Any] = {
    **FLAT_WORLD,
    "assets": {
        "rocks": [{"kind": "angular", "count": [12, 12], "size_m": [0.3, 0.6]}],
        "objects": [
            {"name": "mark", "shape": "boulder", "position_m": [-6, 2, 0]}
            | {"label": "mark", "semantic_id": 12}
        ],
        "movers": [
            {"name": "rover", "shape": "rover", "label": "rover", "semantic_id": 14}
            | {"trajectory": {"waypoints_m": [[-8, -8], [8, -8]]}}
        ],
    },
}
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


def spawn(simulator: Simulator, name: str, xyz: Sequence[float] = (3, 3, 0), **fields: Any) -> Any:
    """Return code, message and name; the resource is a boulder unless fields say otherwise."""
    resource = Resource(
        uri=fields.pop("uri", "" if "resource_string" in fields else "shape:boulder"),
        resource_string=fields.pop("resource_string", ""),
    )
    x, y, z = map(float, xyz)
    pose = fields.pop("initial_pose", stamped(Pose((x, y, z), (0.0, 0.0, 0.0, 1.0))))
    asked = {"name": name, "entity_resource": resource, "initial_pose": pose, **fields}
    code, message, answer = simulator.call("SpawnEntity", **asked)
    return code, message, answer.entity_name


def instances_from(simulator: Simulator, pose: Pose) -> set[int]:
    """Render, and return the instance ids in the image."""
    answer = simulator.user.set_pose(pose)
    assert answer.success, answer.message
    images = simulator.user.received[INSTANCE]
    simulator.user.wait_until(lambda: images and images[-1].header.stamp == answer.stamp)
    return set(np.unique(image_from_msg(images[-1])).tolist()) - {0}


def id_of(simulator: Simulator, entity: str) -> int:
    tags = simulator.call("GetEntityInfo", entity=entity)[2].info.tags
    (number,) = [tag.removeprefix("instance_id:") for tag in tags if "instance_id:" in tag]
    return int(number)


@pytest.mark.long
def test_things_are_spawned_moved_and_deleted_and_the_picture_agrees(
    simulator: Simulator,
) -> None:
    above = pose_looking_down(3, 3, 6)
    assert id_of(simulator, "mark") not in instances_from(simulator, above)
    code, message, name = spawn(simulator, "stone", resource_string='{"shape": "slab", "scale": 2}')
    assert (code, name) == (Result.RESULT_OK, "stone"), message
    assert simulator.position("stone") == [3, 3, 0]
    stone = id_of(simulator, "stone")
    assert f"instance {stone}" in message
    assert stone in instances_from(simulator, above)

    away = Pose((-3.0, -3.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    assert simulator.put("stone", away)[0] == Result.RESULT_OK
    assert simulator.position("stone") == [-3, -3, 0]
    assert stone not in instances_from(simulator, above)
    assert stone in instances_from(simulator, pose_looking_down(-3, -3, 6))
    assert simulator.call("DeleteEntity", entity="stone")[0] == Result.RESULT_OK
    assert simulator.call("GetEntityState", entity="stone")[0] == Result.RESULT_NOT_FOUND
    assert stone not in instances_from(simulator, pose_looking_down(-3, -3, 6))
    # The name is free again, and nothing of the old one comes back with it.
    assert spawn(simulator, "stone", uri="prototype:mark")[0] == Result.RESULT_OK
    assert stone in instances_from(simulator, above)

    mark = id_of(simulator, "mark")
    assert simulator.put("mark", Pose((6.0, 6.0, 0.0), (0.0, 0.0, 0.0, 1.0)))[0] == Result.RESULT_OK
    assert mark in instances_from(simulator, pose_looking_down(6, 6, 6))
    assert simulator.call("DeleteEntity", entity="mark")[0] == Result.RESULT_OK
    assert "mark" not in simulator.entities()
    assert mark not in instances_from(simulator, pose_looking_down(6, 6, 6))
    assert simulator.call("ResetSimulation", scope=0)[0] == Result.RESULT_OK
    assert {"mark"} == {"mark", "stone"} & set(simulator.entities())


@pytest.mark.long
def test_meshes_within_the_asset_roots_can_be_spawned_and_no_others(
    simulator: Simulator, meshes: Path, tmp_path: Path
) -> None:
    roots = [meshes, tmp_path]
    for root in roots:
        (root / "tetra.obj").write_text(TETRAHEDRON)
    codes = srv.SpawnEntity.Response
    code, message, name = spawn(simulator, "", uri=f"file://{roots[0] / 'tetra.obj'}")
    assert (code, name) == (Result.RESULT_OK, "tetra_1"), message
    assert id_of(simulator, name) in instances_from(simulator, pose_looking_down(3, 3, 6))
    assert spawn(simulator, "t2", uri=str(roots[0] / "tetra.obj"))[0] == Result.RESULT_OK
    assert spawn(simulator, "t3", uri=str(roots[1] / "tetra.obj"))[0] == codes.MISSING_ASSETS
    assert spawn(simulator, "t4", uri=str(roots[0] / "none.obj"))[0] == codes.MISSING_ASSETS
    added = TagsFilter(tags=["added"])
    assert simulator.entities(tags=added) == sorted(
        ["tetra_1", "t2"], key=lambda n: id_of(simulator, n)
    )


def test_what_cannot_be_spawned_is_refused_with_its_reason(simulator: Simulator) -> None:
    codes = srv.SpawnEntity.Response
    nowhere = Pose((0.0, 0.0, float("nan")), (0.0, 0.0, 0.0, 1.0))
    for name, fields, expected in (
        ("1 stone", {}, codes.NAME_INVALID),
        ("mark", {}, codes.NAME_NOT_UNIQUE),
        ("camera", {}, codes.NAME_NOT_UNIQUE),
        ("a", {"entity_namespace": "robot"}, codes.NAMESPACE_INVALID),
        ("a", {"uri": "", "resource_string": ""}, codes.NO_RESOURCE),
        ("a", {"uri": "https://example.org/rover.sdf"}, codes.UNSUPPORTED_FORMAT),
        ("a", {"uri": "shape:castle"}, codes.MISSING_ASSETS),
        ("a", {"uri": "prototype:castle"}, codes.MISSING_ASSETS),
        ("a", {"resource_string": "<sdf/>"}, codes.RESOURCE_PARSE_ERROR),
        ("a", {"resource_string": '{"shape": "boulder", "mass": 2}'}, codes.RESOURCE_PARSE_ERROR),
        ("a", {"resource_string": '{"shape": "boulder", "scale": -2}'}, codes.RESOURCE_PARSE_ERROR),
        ("a", {"initial_pose": stamped(nowhere)}, codes.INVALID_POSE),
        ("a", {"initial_pose": stamped(down(1), "elsewhere")}, codes.INVALID_POSE),
    ):
        code, message, _ = spawn(simulator, name, **fields)
        assert (code, bool(message)) == (expected, True), (name, fields, message)
    assert spawn(simulator, "mark", allow_renaming=True)[2] == "mark_1"
    for entity in ("base_link", "camera"):
        code, message, _ = simulator.call("DeleteEntity", entity=entity)
        assert (code, "stay" in message) == (Result.RESULT_OPERATION_FAILED, True)
    assert simulator.call("DeleteEntity", entity="nobody")[0] == Result.RESULT_NOT_FOUND
    # Nothing that was refused waits for the next sample.
    assert simulator.user.set_pose(down(5)).success
    assert simulator.entities(tags=TagsFilter(tags=["added"])) == ["mark_1"]


@pytest.mark.long
def test_scattered_things_are_listed_by_filter_and_never_without_a_bound(
    simulator: Simulator,
) -> None:
    everything = simulator.entities()
    assert everything[:2] == ["base_link", "camera"]
    assert {"mark", "rover"} < set(everything)
    rocks = simulator.entities(filter="^angular_[[:digit:]]+$")
    assert len(rocks) == 12
    assert simulator.entities(tags=TagsFilter(tags=["rock"])) == rocks
    dynamic = [EntityCategory(category=EntityCategory.CATEGORY_DYNAMIC_OBJECT)]
    assert simulator.entities(categories=dynamic) == ["rover"]
    x, y, z = simulator.position(rocks[0])
    assert rocks[0] in simulator.entities(bounds=box((x - 1, y - 1, z - 1), (x + 1, y + 1, z + 1)))
    near = box((x, y, z), (0.01, 0, 0), kind=Bounds.TYPE_SPHERE)
    assert simulator.entities(bounds=near) == [rocks[0]]
    info = simulator.call("GetEntityInfo", entity=rocks[0])[2].info
    assert info.category.category == EntityCategory.CATEGORY_STATIC_OBJECT
    assert "label rock (10)" in info.description

    usual = next(row.default for row in BRIDGE if row.name == "max_entities")
    set_max_entities(simulator, 5)
    code, message, answer = simulator.call("GetEntities", filters=EntityFilters())
    assert (code, len(answer.entities)) == (Result.RESULT_OK, 7)
    assert "9 more are left out" in message
    only_rocks = EntityFilters(filter="angular")
    code, message, answer = simulator.call("GetEntitiesStates", filters=only_rocks)
    assert (code, len(answer.entities), len(answer.states)) == (Result.RESULT_OK, 5, 5)
    assert "left out" in message
    set_max_entities(simulator, usual)


def set_max_entities(simulator: Simulator, number: Any) -> None:
    parameter = Parameter("max_entities", value=number).to_parameter_msg()
    request = SetParameters.Request(parameters=[parameter])
    answer = simulator.user.call(SetParameters, "set_parameters", request)
    assert answer.results[0].successful


@pytest.mark.long
def test_a_paused_simulation_shows_what_was_spawned_at_its_next_step(simulator: Simulator) -> None:
    assert simulator.user.set_pose(pose_looking_down(3, 3, 6)).success
    assert simulator.set_state(PAUSED)[0] == Result.RESULT_OK
    assert spawn(simulator, "stone")[0] == Result.RESULT_OK
    assert simulator.position("stone") == [3, 3, 0]
    assert simulator.call("StepSimulation", steps=1)[0] == Result.RESULT_OK
    images = simulator.user.received[INSTANCE]
    simulator.user.wait_until(lambda: len(images) == 2)
    stone = id_of(simulator, "stone")
    seen = [stone in image_from_msg(image) for image in images]
    assert seen == [False, True]
    assert simulator.set_state(PLAYING)[0] == Result.RESULT_OK
