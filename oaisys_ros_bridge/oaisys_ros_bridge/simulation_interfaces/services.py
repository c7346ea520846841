"""The services and the action of ``simulation_interfaces``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import simulation_interfaces.srv as srv
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import Resource, Result, SimulatorFeatures, WorldResource

from oaisys_core.errors import InvalidInputError, NotReadyError, OaisysError, quote
from oaisys_ros_bridge.bridge.goal_server import GoalServer, GoalWork
from oaisys_ros_bridge.bridge.render_queue import RenderQueue
from oaisys_ros_bridge.bridge.requests import Cancellation
from oaisys_ros_bridge.parameters.table import Settings
from oaisys_ros_bridge.qos import SERVICE_QOS
from oaisys_ros_bridge.services import NodeServices
from oaisys_ros_bridge.simulation_interfaces.entity_services import EntityServices
from oaisys_ros_bridge.simulation_interfaces.results import RefusedError, offer_services
from oaisys_ros_bridge.simulation_interfaces.simulation_control import (
    NO_WORLD,
    PAUSED,
    PLAYING,
    QUITTING,
    STATE_NAMES,
    STOPPED,
    SimulationControl,
)
from oaisys_ros_bridge.simulation_interfaces.spawning import SPAWN_FORMATS
from oaisys_ros_bridge.simulation_interfaces.worlds import (
    WorldRequest,
    world_from_json,
    world_from_uri,
)

UNSUPPORTED = (
    *("GetEntityBounds", "GetNamedPoseBounds", "GetNamedPoses", "GetSpawnables"),
    *("SetEntityInfo", "SpawnEntities", "UnloadWorld"),
)
"""Services that answer that they are not supported, if their types are installed."""

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


class SimulationServices:
    """Offers state, steps and worlds of the simulation, and its entities.

    Args:
        node: Offers the action.
        services: Of the node.
        simulation: State and world of the simulation.
        render_queue: Renders where an entity is put.
        settings: Returns the bridge's parameters.
    """

    def __init__(
        self,
        node: Node,
        services: NodeServices,
        simulation: SimulationControl,
        render_queue: RenderQueue,
        settings: Settings,
    ) -> None:
        self._simulation = simulation
        node.create_service(
            srv.GetSimulatorFeatures,
            "~/get_simulator_features",
            self._on_get_features,
            qos_profile=SERVICE_QOS,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        EntityServices(services, simulation, render_queue, settings)
        offer_services(
            services,
            {
                srv.GetSimulationState: self._get_simulation_state,
                srv.SetSimulationState: self._set_simulation_state,
                srv.StepSimulation: self._step_simulation,
                srv.ResetSimulation: self._reset_simulation,
                srv.LoadWorld: self._load_world,
                srv.GetCurrentWorld: self._get_current_world,
                srv.GetAvailableWorlds: self._get_available_worlds,
            },
        )
        installed = [getattr(srv, name) for name in UNSUPPORTED if hasattr(srv, name)]
        offer_services(services, dict.fromkeys(installed, _refuse_unsupported))
        work_of_action = GoalWork(SimulateSteps, "~/simulate_steps", self._simulate_steps, _explain)
        self._steps = GoalServer(node, work_of_action)

    def stop(self, reason: str) -> None:
        """Cancel the steps that are under way."""
        self._steps.stop(reason)

    def _on_get_features(self, _request: Any, response: Any) -> Any:
        features = set(FEATURES)
        if self._simulation.has_clock:
            features.add(SimulatorFeatures.SIMULATION_RESET_TIME)
        response.features.features = sorted(features)
        response.features.spawn_formats = list(SPAWN_FORMATS)
        response.features.custom_info = CUSTOM_INFO
        return response

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
                message = (
                    f"uri: received {quote(resource.uri)}, expected oaisys:SEED or oaisys:next"
                )
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
        """List the current world and the next one; every other seed is a world, too."""
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


def _steps(steps: int) -> Sequence[int]:
    """Return the numbers of the steps; `InvalidInputError` for none."""
    if steps < 1:
        raise InvalidInputError("steps", steps, "1 or more")
    return range(1, steps + 1)


def _refuse_unsupported(_request: Any, _response: Any) -> None:
    raise RefusedError(Result.RESULT_FEATURE_UNSUPPORTED, "see get_simulator_features")


def _explain(_goal: ServerGoalHandle, result: SimulateSteps.Result, reason: str) -> None:
    result.result = Result(result=Result.RESULT_OPERATION_FAILED, error_message=reason)
