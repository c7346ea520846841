"""The services and the action of ``simulation_interfaces``, on top of the bridge's own requests."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

import simulation_interfaces.srv as srv
from geometry_msgs.msg import PoseStamped
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import (
    EntityCategory,
    EntityInfo,
    EntityState,
    Resource,
    Result,
    SimulatorFeatures,
    WorldResource,
)
from std_msgs.msg import Header

from oaisys_core.errors import InvalidInputError, NotReadyError, OaisysError
from oaisys_ros_bridge.bridge.cancellation import Cancellation
from oaisys_ros_bridge.bridge.goal_server import GoalServer, GoalWork
from oaisys_ros_bridge.bridge.rendering import Renderer, View
from oaisys_ros_bridge.bridge.requests import rig_pose
from oaisys_ros_bridge.conversions import pose_to_msg, pose_to_stamped_msg
from oaisys_ros_bridge.simulation_interfaces.entities import (
    Entity,
    UnsupportedBoundsError,
    entities_of,
    filtered,
)
from oaisys_ros_bridge.simulation_interfaces.scene_entities import NameTakenError, SceneEntities
from oaisys_ros_bridge.simulation_interfaces.simulation import (
    NO_WORLD,
    PAUSED,
    PLAYING,
    QUITTING,
    STATE_NAMES,
    STOPPED,
    Simulation,
)
from oaisys_ros_bridge.simulation_interfaces.spawning import (
    NAME,
    SPAWN_FORMATS,
    UnsupportedFormatError,
    spec_of,
    stem_of,
)
from oaisys_ros_bridge.simulation_interfaces.worlds import (
    WorldRequest,
    world_from_json,
    world_from_uri,
)

UNSUPPORTED = (
    *("GetEntityBounds", "GetNamedPoseBounds", "GetNamedPoses", "GetSpawnables"),
    *("SetEntityInfo", "SpawnEntities", "UnloadWorld"),
)
"""Services that answer that they are not supported, where the machine has their types."""

FEATURES = (
    SimulatorFeatures.SPAWNING,
    SimulatorFeatures.SPAWNING_RESOURCE_STRING,
    SimulatorFeatures.DELETING,
    SimulatorFeatures.ENTITY_TAGS,
    SimulatorFeatures.ENTITY_BOUNDS_BOX,
    SimulatorFeatures.ENTITY_CATEGORIES,
    SimulatorFeatures.ENTITY_STATE_GETTING,
    SimulatorFeatures.ENTITY_STATE_SETTING,
    SimulatorFeatures.ENTITY_INFO_GETTING,
    SimulatorFeatures.SIMULATION_RESET,
    SimulatorFeatures.SIMULATION_RESET_STATE,
    SimulatorFeatures.SIMULATION_STATE_GETTING,
    SimulatorFeatures.SIMULATION_STATE_SETTING,
    SimulatorFeatures.SIMULATION_STATE_PAUSE,
    SimulatorFeatures.STEP_SIMULATION_SINGLE,
    SimulatorFeatures.STEP_SIMULATION_MULTIPLE,
    SimulatorFeatures.STEP_SIMULATION_ACTION,
    SimulatorFeatures.WORLD_LOADING,
    SimulatorFeatures.WORLD_RESOURCE_STRING,
    SimulatorFeatures.WORLD_TAGS,
    SimulatorFeatures.WORLD_INFO_GETTING,
    SimulatorFeatures.AVAILABLE_WORLDS,
)
CUSTOM_INFO = (
    "A step is one sample. Entities are the rig, its sensors and the things on the ground; what is "
    "spawned, moved or deleted is so from the next sample on. Resources are shape:NAME, "
    "prototype:NAME of something configured, mesh files within the simulator's asset roots, or a "
    "JSON object of the keys of asset.add. Worlds are oaisys:SEED and oaisys:next, or a JSON "
    "object with seed, reuse_stage and metadata."
)


_POSE_FIELD = re.compile(r"^pose|sensor\.pose|position_m$|quat_xyzw$")


class RefusedError(OaisysError):
    """A request is answered with a result code of its own."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class SimulationServices:
    """Offers them, all names beginning with the node's.

    Args:
        node: That they are of.
        simulation: What they ask.
        renderer: Renders where an entity is put.
        base_frame: Returns the name of the rig.
        max_entities: Returns how many things on the ground an answer lists at most.
    """

    def __init__(
        self,
        node: Node,
        simulation: Simulation,
        renderer: Renderer,
        base_frame: Callable[[], str],
        max_entities: Callable[[], int],
    ) -> None:
        self._max_entities = max_entities
        self._things = SceneEntities(simulation.link, renderer.metadata)
        self._node = node
        self._simulation = simulation
        self._renderer = renderer
        self._base_frame = base_frame
        node.create_service(
            srv.GetSimulatorFeatures, "~/get_simulator_features", self._on_get_features
        )
        for kind, name, work in (
            (srv.GetEntities, "get_entities", self._get_entities),
            (srv.GetEntitiesStates, "get_entities_states", self._get_entities_states),
            (srv.GetEntityInfo, "get_entity_info", self._get_entity_info),
            (srv.GetEntityState, "get_entity_state", self._get_entity_state),
            (srv.SetEntityState, "set_entity_state", self._set_entity_state),
            (srv.SpawnEntity, "spawn_entity", self._spawn_entity),
            (srv.DeleteEntity, "delete_entity", self._delete_entity),
            (srv.GetSimulationState, "get_simulation_state", self._get_simulation_state),
            (srv.SetSimulationState, "set_simulation_state", self._set_simulation_state),
            (srv.StepSimulation, "step_simulation", self._step_simulation),
            (srv.ResetSimulation, "reset_simulation", self._reset_simulation),
            (srv.LoadWorld, "load_world", self._load_world),
            (srv.GetCurrentWorld, "get_current_world", self._get_current_world),
            (srv.GetAvailableWorlds, "get_available_worlds", self._get_available_worlds),
        ):
            self._offer(kind, name, work)
        for type_name in UNSUPPORTED:
            if hasattr(srv, type_name):
                self._offer(getattr(srv, type_name), _snake(type_name), _unsupported)
        work_of_action = GoalWork(SimulateSteps, "~/simulate_steps", self._simulate_steps, _explain)
        self._steps = GoalServer(node, work_of_action)

    def stop(self, reason: str) -> None:
        """End the steps that are under way."""
        self._steps.stop(reason)

    def _offer(self, kind: Any, name: str, work: Callable[[Any, Any], None]) -> None:
        def answer(request: Any, response: Any) -> Any:
            response.result.result = Result.RESULT_OK
            try:
                work(request, response)
            except OaisysError as error:
                response.result = _result_of(error)
            return response

        group = MutuallyExclusiveCallbackGroup()
        self._node.create_service(kind, f"~/{name}", answer, callback_group=group)

    def _on_get_features(self, _request: Any, response: Any) -> Any:
        features = set(FEATURES)
        if self._simulation.has_clock:
            features.add(SimulatorFeatures.SIMULATION_RESET_TIME)
        response.features.features = sorted(features)
        response.features.spawn_formats = list(SPAWN_FORMATS)
        response.features.custom_info = CUSTOM_INFO
        return response

    def _get_entities(self, request: Any, response: Any) -> None:
        entities, response.result.error_message = self._filtered(request.filters)
        response.entities = [entity.name for entity in entities]

    def _get_entities_states(self, request: Any, response: Any) -> None:
        entities, response.result.error_message = self._filtered(request.filters)
        response.states = [self._state_of(entity) for entity in entities]
        response.entities = [entity.name for entity in entities]

    def _get_entity_info(self, request: Any, response: Any) -> None:
        entity = self._entity(request.entity)
        category = EntityCategory(category=entity.category)
        tags = list(entity.tags)
        response.info = EntityInfo(category=category, description=entity.description, tags=tags)

    def _get_entity_state(self, request: Any, response: Any) -> None:
        response.state = self._state_of(self._entity(request.entity))

    def _set_entity_state(self, request: Any, response: Any) -> None:
        entity = self._entity(request.entity)
        state = request.state
        for wanted, name, value in (
            (request.set_twist, "twist", state.twist),
            (request.set_acceleration, "acceleration", state.acceleration),
        ):
            if wanted and value != type(value)():
                message = f"state.{name}: nothing has one here, expected zero"
                raise RefusedError(Result.RESULT_OPERATION_FAILED, message)
        if request.set_pose:
            self._put(entity, PoseStamped(header=state.header, pose=state.pose))

    def _put(self, entity: Entity, pose: PoseStamped) -> None:
        """Put an entity somewhere: render there if the simulation plays, else at its next step."""
        info, map_frame = self._simulation.info(), self._renderer.map_frame()
        try:
            if entity.thing is not None:
                self._things.move(entity.thing, rig_pose(pose, "", info, map_frame))
                return
            where = rig_pose(pose, entity.sensor, info, map_frame)
            if self._simulation.state in (PAUSED, STOPPED):
                self._simulation.put_rig(where)
            else:
                self._renderer.render(View(pose_to_stamped_msg(where, Header())))
        except InvalidInputError as error:
            if not _POSE_FIELD.search(error.field):
                raise
            raise RefusedError(srv.SetEntityState.Response.INVALID_POSE, str(error)) from error

    def _spawn_entity(self, request: Any, response: Any) -> None:
        codes = srv.SpawnEntity.Response
        if request.entity_namespace:
            message = "entity_namespace: things on the ground have none, expected it empty"
            raise RefusedError(codes.NAMESPACE_INVALID, message)
        resource = request.entity_resource
        if not resource.uri and not resource.resource_string:
            message = "entity_resource: uri and resource_string are both empty"
            raise RefusedError(codes.NO_RESOURCE, message)
        try:
            info = self._simulation.info()
            spec = spec_of(resource, info.semantic_labels)
            name = self._name_for(request, stem_of(spec))
            pose = rig_pose(request.initial_pose, "", info, self._renderer.map_frame())
            thing = self._things.spawn(name, spec, pose)
        except UnsupportedFormatError as error:
            raise RefusedError(codes.UNSUPPORTED_FORMAT, str(error)) from error
        except NameTakenError as error:
            raise RefusedError(codes.NAME_NOT_UNIQUE, str(error)) from error
        except InvalidInputError as error:
            raise RefusedError(_spawn_code(error.field), str(error)) from error
        response.entity_name = thing.name
        response.result.error_message = (
            f"instance {thing.instance_id}, there from the next sample on"
        )

    def _name_for(self, request: Any, stem: str) -> str:
        """Return the name of what is spawned, another one than asked for where that is allowed."""
        own = {e.name for e in entities_of(self._simulation.info(), self._base_frame())}
        name = request.name
        if name and not NAME.fullmatch(name):
            message = f"name: received {name!r}, expected a letter, then letters, digits, _ or -"
            raise RefusedError(srv.SpawnEntity.Response.NAME_INVALID, message)
        if not name:
            return self._things.free_name(stem, own)
        if name not in own and self._things.find(name) is None:
            return str(name)
        if request.allow_renaming:
            return self._things.free_name(name, own)
        raise NameTakenError(f"name: received {name!r}, which something has already")

    def _delete_entity(self, request: Any, response: Any) -> None:
        entity = self._entity(request.entity)
        if entity.thing is None:
            message = f"entity: received {entity.name!r}, the rig and its sensors stay"
            raise RefusedError(Result.RESULT_OPERATION_FAILED, message)
        self._things.delete(entity.thing)

    def _get_simulation_state(self, _: Any, response: Any) -> None:
        response.state.state = NO_WORLD  # where the next line raises
        response.state.state = self._simulation.state

    def _set_simulation_state(self, request: Any, response: Any) -> None:
        target, state = request.state.state, self._simulation.state
        enter = {
            PLAYING: self._simulation.resume,
            PAUSED: self._simulation.pause,
            STOPPED: self._simulation.stop,
            QUITTING: self._simulation.quit,
        }
        if target == state:
            message = f"the simulation is {STATE_NAMES[state]} already"
            raise RefusedError(srv.SetSimulationState.Response.ALREADY_IN_TARGET_STATE, message)
        if target not in enter:
            message = f"state: received {target}, expected one of {sorted(enter)}"
            raise RefusedError(srv.SetSimulationState.Response.INCORRECT_TRANSITION, message)
        if state not in enter and target != QUITTING:
            raise NotReadyError(f"the simulation is {STATE_NAMES[state]}")
        try:
            enter[target]()
        except OaisysError as error:
            code = srv.SetSimulationState.Response.STATE_TRANSITION_ERROR
            raise RefusedError(code, str(error)) from error

    def _step_simulation(self, request: Any, response: Any) -> None:
        for _ in _steps(request.steps):
            try:
                self._simulation.step()
            except NotReadyError as error:
                raise RefusedError(Result.RESULT_OPERATION_FAILED, str(error)) from error

    def _simulate_steps(
        self, goal: ServerGoalHandle, cancellation: Cancellation, result: SimulateSteps.Result
    ) -> None:
        steps = goal.request.steps
        for done in _steps(steps):
            self._simulation.step(cancellation)
            goal.publish_feedback(
                SimulateSteps.Feedback(completed_steps=done, remaining_steps=steps - done)
            )
        result.result.result = Result.RESULT_OK

    def _reset_simulation(self, request: Any, response: Any) -> None:
        kind = srv.ResetSimulation.Request
        scope = request.scope or kind.SCOPE_ALL
        if scope & kind.SCOPE_STATE:
            self._simulation.restart()
        elif scope == kind.SCOPE_TIME and self._simulation.has_clock:
            self._simulation.restart_clock()
        else:
            message = f"scope: received {scope}, expected SCOPE_STATE (2) or SCOPE_ALL"
            raise RefusedError(Result.RESULT_FEATURE_UNSUPPORTED, message)

    def _load_world(self, request: Any, response: Any) -> None:
        codes = srv.LoadWorld.Response
        resource = request.world_resource
        if not resource.uri and not resource.resource_string:
            message = "world_resource: uri and resource_string are both empty"
            raise RefusedError(codes.NO_RESOURCE, message)
        try:
            world: WorldRequest | None
            if resource.uri:
                world = world_from_uri(resource.uri)
            else:
                world = world_from_json(resource.resource_string)
            if world is None:
                message = f"uri: received {resource.uri!r}, expected oaisys:SEED or oaisys:next"
                raise RefusedError(codes.UNSUPPORTED_FORMAT, message)
            self._simulation.load(world)
        except InvalidInputError as error:
            raise RefusedError(codes.RESOURCE_PARSE_ERROR, str(error)) from error
        response.world = self._current_world()

    def _get_current_world(self, _: Any, response: Any) -> None:
        if self._simulation.info().batch_id == 0:
            code = srv.GetCurrentWorld.Response.NO_WORLD_LOADED
            raise RefusedError(code, "no world has been built yet")
        response.world = self._current_world()

    def _get_available_worlds(self, request: Any, response: Any) -> None:
        """Name the world that stands and the next one; all other seeds are worlds, too."""
        info = self._simulation.info()
        following = WorldResource(
            name="next",
            world_resource=Resource(uri=WorldRequest().uri),
            description="the next world of the simulator's series",
            tags=[info.backend],
        )
        worlds = [following]
        if info.batch_id > 0 and self._simulation.seed is not None:
            worlds.insert(0, self._current_world())
        wanted = set(request.filter.tags)
        everything = request.filter.filter_mode == request.filter.FILTER_MODE_ALL
        chosen = wanted.issubset if everything else (lambda tags: bool(wanted.intersection(tags)))
        response.worlds = [w for w in worlds if not wanted or chosen(w.tags)]
        if request.additional_sources:
            response.result.error_message = "additional_sources: there are none for these worlds"

    def _current_world(self) -> WorldResource:
        info, seed = self._simulation.info(), self._simulation.seed
        uri = "" if seed is None else WorldRequest(seed).uri
        config = info.config_sha256[:12]
        return WorldResource(
            name=f"batch {info.batch_id}",
            world_resource=Resource(uri=uri),
            description=f"configuration {config}, {info.backend} {info.backend_version}",
            tags=[info.backend, info.quality],
        )

    def _filtered(self, filters: Any) -> tuple[list[Entity], str]:
        """Return what filters let through, and what was left out of it, in words."""
        try:
            entities = entities_of(self._simulation.info(), self._base_frame())
            found = filtered(entities, filters, self._simulation.rig_pose)
            things, left_out = self._things.matching(filters, self._max_entities())
            return found + things, left_out
        except UnsupportedBoundsError as error:
            raise RefusedError(Result.RESULT_FEATURE_UNSUPPORTED, str(error)) from error

    def _entity(self, name: str) -> Entity:
        entities = {e.name: e for e in entities_of(self._simulation.info(), self._base_frame())}
        entity = entities.get(name) or self._things.find(name)
        if entity is None:
            expected = f"one of {', '.join(entities)}, or something on the ground (get_entities)"
            message = f"entity: received {name!r}, expected {expected}"
            raise RefusedError(Result.RESULT_NOT_FOUND, message)
        return entity

    def _state_of(self, entity: Entity) -> EntityState:
        pose = entity.pose(self._simulation.rig_pose)
        if pose is None:
            message = f"{entity.name}: its pose is known from the first sample on"
            raise RefusedError(Result.RESULT_OPERATION_FAILED, message)
        header = Header(
            stamp=self._node.get_clock().now().to_msg(), frame_id=self._renderer.map_frame()
        )
        return EntityState(header=header, pose=pose_to_msg(pose))


def _steps(steps: int) -> Sequence[int]:
    """Return the numbers of the steps; `InvalidInputError` for none."""
    if steps < 1:
        raise InvalidInputError("steps", steps, "1 or more")
    return range(1, steps + 1)


def _spawn_code(field: str) -> int:
    """Return what a refused field of something that is spawned means."""
    codes = srv.SpawnEntity.Response
    if _POSE_FIELD.search(field):
        return int(codes.INVALID_POSE)
    if re.search(r"\.(file|shape|prototype|texture)$", field):
        return int(codes.MISSING_ASSETS)
    return int(codes.RESOURCE_PARSE_ERROR)


def _unsupported(_request: Any, _response: Any) -> None:
    raise RefusedError(Result.RESULT_FEATURE_UNSUPPORTED, "see get_simulator_features")


def _explain(_goal: ServerGoalHandle, result: SimulateSteps.Result, reason: str) -> None:
    result.result = Result(result=Result.RESULT_OPERATION_FAILED, error_message=reason)


def _result_of(error: OaisysError) -> Result:
    code = Result.RESULT_OPERATION_FAILED
    if isinstance(error, RefusedError):
        code = error.code
    elif isinstance(error, NotReadyError):
        code = Result.RESULT_INCORRECT_STATE
    return Result(result=code, error_message=str(error))


def _snake(name: str) -> str:
    return "".join("_" + c.lower() if c.isupper() else c for c in name).removeprefix("_")
