"""Objects of a world, as queries list them."""

from __future__ import annotations

from dataclasses import dataclass

from oaisys_core.types.poses import Pose

MAX_OBJECTS = 5000
"""Largest number of objects in an `ObjectPage`, which then fits gRPC's default message size."""


@dataclass(frozen=True)
class ObjectQuery:
    """Selects objects of a world that meet all the conditions; an empty one admits all.

    Attributes:
        kinds: ``rock``, ``solid``, ``group``, ``object``, ``mover``, ``added``.
        groups: Kinds of rock, names of groups, shapes of solids.
        names: Whole names.
        instance_ids: Instance ids.
        low_m, high_m: Corners of a box in ``map`` that contains the object's position.
        after_instance_id: Largest id of the previous page; only larger ids are returned.
        limit: Largest number of objects to return.
    """

    kinds: tuple[str, ...] = ()
    groups: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    instance_ids: tuple[int, ...] = ()
    low_m: tuple[float, float, float] | None = None
    high_m: tuple[float, float, float] | None = None
    after_instance_id: int = 0
    limit: int = 1000


@dataclass(frozen=True)
class SceneObject:
    """A visible object of a world.

    Attributes:
        name: Its unique name: its own, or its group or kind with the instance id.
        kind: See `ObjectQuery`.
        group: Kind of rock, name of the group or shape of a solid; else empty.
        label, semantic_id: Label on level 0.
        pose: Pose in ``map`` of the centre of its base, or of a solid's centre.
        scale: Factor on the size of its shape.
        low_m, high_m: Corners of its axis-aligned bounding box in ``map``.
        box_low_m, box_high_m: Corners of its bounding box along its own axes, in the frame of
            ``pose``, in metres: scaled.
    """

    instance_id: int
    name: str
    kind: str
    group: str
    label: str
    semantic_id: int
    pose: Pose
    scale: float
    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]
    box_low_m: tuple[float, float, float]
    box_high_m: tuple[float, float, float]


@dataclass(frozen=True)
class ObjectPage:
    """Objects of a world in the order of their instance ids.

    Attributes:
        total: Number of objects that the query selects, on all pages.
        next_after_instance_id: ``after_instance_id`` of the next page; 0 if there is none.
    """

    objects: tuple[SceneObject, ...]
    total: int
    next_after_instance_id: int
