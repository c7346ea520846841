"""The objects on the ground as entities: listed, added, moved and deleted by name.

A change is metadata that waits for the next sample. The simulator checks it at once, and lists
objects as they will be at that sample.
"""

from __future__ import annotations

import threading
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from oaisys_core.errors import NotFoundError, quote
from oaisys_core.types import (
    MAX_OBJECTS,
    ModuleMetadata,
    ObjectPage,
    ObjectQuery,
    Pose,
    SceneObject,
)
from oaisys_ros_bridge.bridge.render_queue import RenderQueue
from oaisys_ros_bridge.simulation_interfaces.entities import (
    Entity,
    EntityFilter,
    entity_of,
)

ADDED = "added"
_UNCHANGED_LOOK: dict[str, Any] = {
    **dict.fromkeys(("shape", "file", "prototype", "object_name", "up_axis", "texture")),
    **dict.fromkeys(("tile_m", "color_srgb")),
    "levels": [],
    "on_ground": False,
    "anchor": "base",
    "scale": 1.0,
    "hidden": False,
}
"""The defaults of all keys of an added object: they replace those of an earlier one of its name."""


class NameTakenError(NotFoundError):
    """The name is taken already."""


class SceneEntities:
    """The objects on the ground.

    Args:
        render_queue: Knows the simulator, and takes changes to the next sample.
    """

    def __init__(self, render_queue: RenderQueue) -> None:
        self._link = render_queue.require_link
        self._pending = render_queue.metadata
        self._changing = threading.Lock()

    def matching(self, wanted: EntityFilter, limit: int) -> tuple[list[Entity], str]:
        """Return the objects that pass the filters, and a note about those that were left out.

        Args:
            wanted: The filters.
            limit: Most entities to return; the others are left out.
        """
        low_m, high_m = _box_of(wanted)
        found: list[Entity] = []
        after, listed, total = 0, 0, 0
        while True:
            size = min(MAX_OBJECTS, max(1, limit + 1)) if wanted.is_by_box else MAX_OBJECTS
            query = ObjectQuery(low_m=low_m, high_m=high_m, after_instance_id=after, limit=size)
            page = self._list_objects(query)
            found += wanted.passing(map(entity_of, page.objects), None)
            listed, total = listed + len(page.objects), page.total
            after = page.next_after_instance_id
            if not after or len(found) > limit:
                break
        if len(found) <= limit:
            return found, ""
        left = f"{total - limit}" if wanted.is_by_box else f"at least {len(found) - limit}"
        note = (
            f"{limit} of the things on the ground are listed and {left} more are left out: "
            f"narrow the filters, or set max_entities ({total - listed} were not looked at)"
        )
        return found[:limit], note

    def find(self, name: str) -> Entity | None:
        """Return the object of a name; None: there is none."""
        objects = self._list_objects(ObjectQuery(names=(name,))).objects
        return entity_of(objects[0]) if objects else None

    def spawn(self, name: str, spec: Mapping[str, Any], pose: Pose) -> SceneObject:
        """Add an object and return it as it will be.

        Args:
            name: Of the object.
            spec: Keys of ``asset.add`` but those of its pose.
            pose: Of its base's centre in ``map``.

        Raises:
            NameTakenError: Another object has the name.
            InvalidInputError: The simulator refuses it.
        """
        with self._changing:
            if self.find(name) is not None:
                raise NameTakenError(f"name: received {quote(name)}, which something has already")
            self._change({"add": {name: {**_UNCHANGED_LOOK, **spec, **_pose_keys(pose)}}})
            entity = self.find(name)
        if entity is None or entity.thing is None:  # the spec hides it
            raise NotFoundError(f"{name} was added hidden, so nobody will find it")
        return entity.thing

    def free_name(self, stem: str, taken: Collection[str]) -> str:
        """Return ``stem`` with the first number that makes it a new name, also among ``taken``."""
        number = 1
        while (name := f"{stem}_{number}") in taken or self.find(name) is not None:
            number += 1
        return name

    def move(self, thing: SceneObject, pose: Pose) -> None:
        """Move an object; one that moves by itself then stays there."""
        with self._changing:
            if thing.kind == ADDED:
                change = {"on_ground": False, **_pose_keys(pose)}
                self._change({"add": {thing.name: change}})
            else:
                self._change({"objects": {str(thing.instance_id): _pose_keys(pose)}})

    def delete(self, thing: SceneObject) -> None:
        """Delete an object; one that is part of the world comes back with a reset."""
        with self._changing:
            if thing.kind == ADDED:
                self._change({"add": {thing.name: None}})
            else:
                self._change({"objects": {str(thing.instance_id): {"hidden": True}}})

    def _change(self, asset: Mapping[str, Any]) -> None:
        """Let the simulator check a change on top of the pending ones, then add it to them."""
        change = ModuleMetadata(asset=asset)
        before = self._pending.asset or ModuleMetadata()
        self._link().list_objects(ObjectQuery(limit=1), before.with_update(change))
        self._pending.add(change)

    def _list_objects(self, query: ObjectQuery) -> ObjectPage:
        link = self._link()
        info = link.state.info
        if info is None or info.batch_id == 0:
            return ObjectPage((), 0, 0)
        return link.list_objects(query, self._pending.asset)


def _pose_keys(pose: Pose) -> dict[str, Any]:
    return {"position_m": list(pose.position_m), "quat_xyzw": list(pose.quat_xyzw)}


Corner = tuple[float, float, float] | None


def _box_of(wanted: EntityFilter) -> tuple[Corner, Corner]:
    """Return the corners of the box around the bounds of a filter."""
    if wanted.points_m is None:
        return None, None
    first, second = wanted.points_m
    if wanted.is_sphere:
        first, second = first - second[0], first + second[0]
    low, high = np.minimum(first, second).tolist(), np.maximum(first, second).tolist()
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])
