"""The services of ``simulation_interfaces`` about entities."""

from __future__ import annotations

import re
from typing import Any

import simulation_interfaces.srv as srv
from geometry_msgs.msg import PoseStamped
from simulation_interfaces.msg import EntityCategory, EntityInfo, EntityState, Result
from std_msgs.msg import Header

from oaisys_core.errors import InvalidInputError, quote
from oaisys_ros_bridge.bridge.render_queue import RenderQueue
from oaisys_ros_bridge.bridge.requests import ViewRequest, rig_pose
from oaisys_ros_bridge.conversions import pose_to_msg, pose_to_stamped_msg
from oaisys_ros_bridge.parameters.table import Settings
from oaisys_ros_bridge.services import NodeServices
from oaisys_ros_bridge.simulation_interfaces.entities import (
    Entity,
    EntityFilter,
    UnsupportedBoundsError,
    entities_of,
)
from oaisys_ros_bridge.simulation_interfaces.results import RefusedError, offer_services
from oaisys_ros_bridge.simulation_interfaces.scene_entities import NameTakenError, SceneEntities
from oaisys_ros_bridge.simulation_interfaces.simulation_control import (
    PAUSED,
    STOPPED,
    SimulationControl,
)
from oaisys_ros_bridge.simulation_interfaces.spawning import (
    NAME,
    UnsupportedFormatError,
    spec_of,
    stem_of,
)

_POSE_FIELD = re.compile(r"^pose|sensor\.pose|position_m$|quat_xyzw$")


class EntityServices:
    """Lists, moves, spawns and deletes entities.

    Args:
        services: Of the node.
        simulation: State and world of the simulation.
        render_queue: Renders where an entity is put.
        settings: Returns the bridge's parameters.
    """

    def __init__(
        self,
        services: NodeServices,
        simulation: SimulationControl,
        render_queue: RenderQueue,
        settings: Settings,
    ) -> None:
        self._simulation = simulation
        self._render_queue = render_queue
        self._settings = settings
        self._things = SceneEntities(render_queue)
        offer_services(
            services,
            {
                srv.GetEntities: self._get_entities,
                srv.GetEntitiesStates: self._get_entities_states,
                srv.GetEntityInfo: self._get_entity_info,
                srv.GetEntityState: self._get_entity_state,
                srv.SetEntityState: self._set_entity_state,
                srv.SpawnEntity: self._spawn_entity,
                srv.DeleteEntity: self._delete_entity,
            },
        )

    def _get_entities(self, request: Any, response: Any) -> None:
        entities, response.result.error_message = self._filter(request.filters)
        response.entities = [entity.name for entity in entities]

    def _get_entities_states(self, request: Any, response: Any) -> None:
        entities, response.result.error_message = self._filter(request.filters)
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
        """Move an entity; render there now if the simulation plays, else at its next step."""
        info, frames = self._simulation.info(), self._render_queue.frames
        try:
            if entity.thing is not None:
                self._things.move(entity.thing, rig_pose(pose, "", info, frames))
                return
            where = rig_pose(pose, entity.sensor, info, frames)
            if self._simulation.state in (PAUSED, STOPPED):
                self._simulation.put_rig(where)
            else:
                self._render_queue.render(ViewRequest(pose_to_stamped_msg(where, Header())))
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
            pose = rig_pose(request.initial_pose, "", info, self._render_queue.frames)
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
        """Return the name of a new entity: if the requested one is taken, perhaps another."""
        own = {e.name for e in self._rig_entities()}
        name = request.name
        if name and not NAME.fullmatch(name):
            message = (
                f"name: received {quote(name)}, expected a letter, then letters, digits, _ or -"
            )
            raise RefusedError(srv.SpawnEntity.Response.NAME_INVALID, message)
        if not name:
            return self._things.free_name(stem, own)
        if name not in own and self._things.find(name) is None:
            return str(name)
        if request.allow_renaming:
            return self._things.free_name(name, own)
        raise NameTakenError(f"name: received {quote(name)}, which something has already")

    def _delete_entity(self, request: Any, response: Any) -> None:
        entity = self._entity(request.entity)
        if entity.thing is None:
            message = f"entity: received {quote(entity.name)}, the rig and its sensors stay"
            raise RefusedError(Result.RESULT_OPERATION_FAILED, message)
        self._things.delete(entity.thing)

    def _filter(self, filters: Any) -> tuple[list[Entity], str]:
        """Return the entities that pass the filters, and a note about those that were left out."""
        try:
            wanted = EntityFilter(filters)
            found = wanted.passing(self._rig_entities(), self._simulation.rig_pose)
            things, left_out = self._things.matching(wanted, self._settings()["max_entities"])
            return found + things, left_out
        except UnsupportedBoundsError as error:
            raise RefusedError(Result.RESULT_FEATURE_UNSUPPORTED, str(error)) from error

    def _rig_entities(self) -> list[Entity]:
        return entities_of(self._simulation.info(), self._settings()["base_frame"])

    def _entity(self, name: str) -> Entity:
        entities = {e.name: e for e in self._rig_entities()}
        entity = entities.get(name) or self._things.find(name)
        if entity is None:
            expected = f"one of {', '.join(entities)}, or something on the ground (get_entities)"
            message = f"entity: received {quote(name)}, expected {expected}"
            raise RefusedError(Result.RESULT_NOT_FOUND, message)
        return entity

    def _state_of(self, entity: Entity) -> EntityState:
        pose = entity.pose(self._simulation.rig_pose)
        if pose is None:
            message = f"{entity.name}: its pose is known from the first sample on"
            raise RefusedError(Result.RESULT_OPERATION_FAILED, message)
        header = Header(stamp=self._simulation.now(), frame_id=self._render_queue.map_frame)
        return EntityState(header=header, pose=pose_to_msg(pose))


def _spawn_code(field: str) -> int:
    """Return the result code for a field of a new entity that was refused."""
    codes = srv.SpawnEntity.Response
    if _POSE_FIELD.search(field):
        return int(codes.INVALID_POSE)
    if re.search(r"\.(file|shape|prototype|texture)$", field):
        return int(codes.MISSING_ASSETS)
    return int(codes.RESOURCE_PARSE_ERROR)
