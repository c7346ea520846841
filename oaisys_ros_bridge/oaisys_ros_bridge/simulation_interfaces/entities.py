"""Entities: the rig, its sensors and the objects on the ground."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import re2
from simulation_interfaces.msg import Bounds, EntityCategory, EntityFilters, TagsFilter

from oaisys_core.errors import InvalidInputError, quote
from oaisys_core.geometry import T_LINK_OPTICAL, invert, pose_from_matrix, pose_to_matrix
from oaisys_core.types import FloatArray, Pose, SceneObject, SimulatorInfo


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


class EntityFilter:
    """Filters of ``simulation_interfaces``, checked whatever entities there are.

    Attributes:
        points_m: The two points of the bounds; None without bounds.
        is_sphere: Whether these are a centre, and a radius as x; else they are corners of a box.
        is_by_box: Whether all that the filters ask for is a box, or nothing.

    Raises:
        InvalidInputError: An invalid filter; `UnsupportedBoundsError` for a convex hull.
    """

    def __init__(self, filters: EntityFilters) -> None:
        self._pattern = _compile(filters.filter)
        self._categories = {category.category for category in filters.categories}
        self._tags = _checked_tags(filters.tags)
        self.is_sphere = filters.bounds.type == Bounds.TYPE_SPHERE
        self.points_m = _points_of(filters.bounds)
        others = filters.filter or self._categories or filters.tags.tags
        self.is_by_box = not (others or self.is_sphere)

    def passing(self, entities: Iterable[Entity], rig_pose: Pose | None) -> list[Entity]:
        """Return the entities that pass.

        An entity counts as a point: it passes bounds that contain its position, and none if that is
        unknown.
        """
        return [
            entity
            for entity in entities
            if self._pattern.search(entity.name)
            and (not self._categories or entity.category in self._categories)
            and self._has_tags(entity)
            and self._is_within(entity, rig_pose)
        ]

    def _has_tags(self, entity: Entity) -> bool:
        if not self._tags.tags:
            return True
        found = [tag in entity.tags for tag in self._tags.tags]
        is_all = self._tags.filter_mode == TagsFilter.FILTER_MODE_ALL
        return all(found) if is_all else any(found)

    def _is_within(self, entity: Entity, rig_pose: Pose | None) -> bool:
        if self.points_m is None:
            return True
        pose = entity.pose(rig_pose)
        if pose is None:
            return False
        position = np.array(pose.position_m)
        if self.is_sphere:
            centre, (radius_m, *_) = self.points_m
            return bool(np.linalg.norm(position - centre) <= radius_m)
        low, high = self.points_m.min(axis=0), self.points_m.max(axis=0)
        return bool(((low <= position) & (position <= high)).all())


def _compile(text: str) -> Any:
    """Return a pattern of RE2, whose time is linear in text and pattern, whoever wrote them."""
    options = re2.Options()
    options.log_errors = False
    try:
        return re2.compile(text, options)
    except re2.error as error:
        cause = error.args[0]
        shown = cause.decode(errors="replace") if isinstance(cause, bytes) else str(cause)
        expected = f"a regular expression of RE2 ({quote(shown)})"
        raise InvalidInputError("filters.filter", text, expected) from None


def _checked_tags(tags: TagsFilter) -> TagsFilter:
    if tags.filter_mode not in (TagsFilter.FILTER_MODE_ANY, TagsFilter.FILTER_MODE_ALL):
        raise InvalidInputError("filters.tags.filter_mode", tags.filter_mode, "0 (any) or 1 (all)")
    return tags


def _points_of(bounds: Bounds) -> FloatArray | None:
    if bounds.type == Bounds.TYPE_EMPTY:
        return None
    if bounds.type not in (Bounds.TYPE_BOX, Bounds.TYPE_SPHERE):
        raise UnsupportedBoundsError("filters.bounds.type", bounds.type, "1 (box) or 3 (sphere)")
    points_m = np.array([[point.x, point.y, point.z] for point in bounds.points])
    if len(points_m) != 2 or not np.isfinite(points_m).all():
        raise InvalidInputError("filters.bounds.points", points_m.tolist(), "two finite points")
    return points_m
