"""Entities: the rig, its sensors and the objects on the ground."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from simulation_interfaces.msg import Bounds, EntityCategory, EntityFilters, TagsFilter

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import T_LINK_OPTICAL, invert, pose_from_matrix, pose_to_matrix
from oaisys_core.types import FloatArray, Pose, SceneObject, SimulatorInfo

_CLASSES = {
    "alnum": "a-zA-Z0-9",
    "alpha": "a-zA-Z",
    "digit": "0-9",
    "lower": "a-z",
    "space": r"\s",
    "upper": "A-Z",
    "xdigit": "0-9A-Fa-f",
}
"""POSIX names of character classes."""


@dataclass(frozen=True)
class Entity:
    """Something with a name and a pose.

    Attributes:
        name: Of a sensor; that of the base frame for the rig.
        sensor: Name of the sensor; empty for all else.
        category: One of ``simulation_interfaces/msg/EntityCategory``.
        description: For people.
        tags: For filters.
        T_base_entity: (4, 4) where it sits on the rig, x forward, y left, z up.
        thing: The object on the ground; None for the rig and its sensors.
    """

    name: str
    sensor: str
    category: int
    description: str
    tags: tuple[str, ...]
    T_base_entity: FloatArray
    thing: SceneObject | None = None

    def pose(self, rig_pose: Pose | None) -> Pose | None:
        """Return its pose in ``map``; None: unknown."""
        if self.thing is not None:
            return self.thing.pose
        if rig_pose is None:
            return None
        return pose_from_matrix(pose_to_matrix(rig_pose) @ self.T_base_entity)


class UnsupportedBoundsError(InvalidInputError):
    """Bounds of a kind that entities cannot be filtered by."""


def entities_of(info: SimulatorInfo, base_frame: str) -> list[Entity]:
    """Return the rig and its sensors."""
    category = EntityCategory.CATEGORY_ROBOT
    rig = Entity(base_frame, "", category, "rig that carries the sensors", ("rig",), np.eye(4))
    sensors = [
        Entity(
            sensor.name,
            sensor.name,
            EntityCategory.CATEGORY_OBJECT,
            f"camera, {sensor.intrinsics.width_px}x{sensor.intrinsics.height_px} pixels",
            ("sensor", *sensor.modalities),
            sensor.T_base_camera @ invert(T_LINK_OPTICAL),
        )
        for sensor in info.sensors
    ]
    return [rig, *sensors]


def entity_of(thing: SceneObject) -> Entity:
    """Return an object on the ground as an entity."""
    moves = thing.kind == "mover"
    category = (
        EntityCategory.CATEGORY_DYNAMIC_OBJECT if moves else EntityCategory.CATEGORY_STATIC_OBJECT
    )
    low, high = (" ".join(f"{v:.3f}" for v in corner) for corner in (thing.low_m, thing.high_m))
    words = f"{thing.group} {thing.kind}".strip()
    description = (
        f"{words}, instance {thing.instance_id}, label {thing.label} ({thing.semantic_id}), "
        f"scale {thing.scale:.3f}, within ({low}) to ({high}) m of the map"
    )
    named = filter(None, (thing.kind, thing.group, thing.label))
    tags = ("thing", *dict.fromkeys(named), f"instance_id:{thing.instance_id}")
    return Entity(thing.name, "", category, description, tags, np.eye(4), thing)


def filter_entities(
    entities: Sequence[Entity], filters: EntityFilters, rig_pose: Pose | None
) -> list[Entity]:
    """Return the entities that pass all filters.

    An entity counts as a point: it passes bounds that contain its position, and none if that is
    unknown.

    Raises:
        InvalidInputError: An invalid filter; `UnsupportedBoundsError` for a convex hull.
    """
    pattern = _compile(filters.filter)
    categories = {category.category for category in filters.categories}
    return [
        entity
        for entity in entities
        if pattern.search(entity.name)
        and (not categories or entity.category in categories)
        and _has_tags(entity, filters.tags)
        and _is_within(entity, filters.bounds, rig_pose)
    ]


def _compile(text: str) -> re.Pattern[str]:
    translated = re.sub(r"\[:(\w+):\]", lambda m: _CLASSES.get(m[1], m[0]), text)
    try:
        return re.compile(translated)
    except re.error as error:
        expected = f"a regular expression ({error})"
        raise InvalidInputError("filters.filter", text, expected) from None


def _has_tags(entity: Entity, tags: TagsFilter) -> bool:
    if tags.filter_mode not in (TagsFilter.FILTER_MODE_ANY, TagsFilter.FILTER_MODE_ALL):
        raise InvalidInputError("filters.tags.filter_mode", tags.filter_mode, "0 (any) or 1 (all)")
    if not tags.tags:
        return True
    found = [tag in entity.tags for tag in tags.tags]
    return all(found) if tags.filter_mode == TagsFilter.FILTER_MODE_ALL else any(found)


def _is_within(entity: Entity, bounds: Bounds, rig_pose: Pose | None) -> bool:
    if bounds.type == Bounds.TYPE_EMPTY:
        return True
    if bounds.type not in (Bounds.TYPE_BOX, Bounds.TYPE_SPHERE):
        raise UnsupportedBoundsError("filters.bounds.type", bounds.type, "1 (box) or 3 (sphere)")
    points = np.array([[point.x, point.y, point.z] for point in bounds.points])
    if len(points) != 2 or not np.isfinite(points).all():
        raise InvalidInputError("filters.bounds.points", points.tolist(), "two finite points")
    pose = entity.pose(rig_pose)
    if pose is None:
        return False
    position = np.array(pose.position_m)
    if bounds.type == Bounds.TYPE_SPHERE:
        return bool(np.linalg.norm(position - points[0]) <= points[1, 0])
    low, high = points.min(axis=0), points.max(axis=0)
    return bool(((low <= position) & (position <= high)).all())
