"""The list of a world's objects, which can be filtered and read page by page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.geometry import pose_from_matrix, transform
from oaisys_core.scene import MeshPrototype, Primitive
from oaisys_core.types import MAX_OBJECTS, FloatArray, ObjectPage, ObjectQuery, SceneObject

KINDS = ("rock", "solid", "group", "object", "mover", "added")
"""Kinds of objects: scattered rocks, primitives, scattered groups, single objects, moving ones, and
those that metadata added."""


@dataclass(frozen=True)
class ObjectInstances:
    """Instances of one prototype, or one primitive.

    Attributes:
        kind: One of `KINDS`.
        group: Kind of rock, name of the group, or shape of the primitive; otherwise "".
        semantic_id: Id on level 0.
        T_map_object: (N, 4, 4) poses with uniform scale.
        instance_ids: (N,).
        low_m, high_m: (3,) corners of the bounding box in the object's frame.
        names: Names by instance id, for objects that have one.
    """

    kind: str
    group: str
    semantic_id: int
    T_map_object: FloatArray
    instance_ids: NDArray[np.uint32]
    low_m: FloatArray
    high_m: FloatArray
    names: Mapping[int, str] = field(default_factory=dict)

    def name_of(self, instance_id: int) -> str:
        """Return the unique name of an instance."""
        return self.names.get(instance_id) or f"{self.group or self.kind}_{instance_id}"


def box_of(prototype: MeshPrototype) -> tuple[FloatArray, FloatArray]:
    """Return the (3,) corners of the bounding box of a mesh in its own frame."""
    vertices = prototype.vertices_m.astype(np.float64)
    return vertices.min(axis=0), vertices.max(axis=0)


def solid(primitive: Primitive) -> ObjectInstances:
    """Return a primitive as a list of one instance."""
    half_m = np.asarray(primitive.size_m) * (1.0 if primitive.shape == "sphere" else 0.5)
    return ObjectInstances(
        "solid",
        primitive.shape,
        primitive.semantic_ids[0],
        primitive.T_map_object[None],
        np.array([primitive.instance_id], np.uint32),
        -half_m,
        half_m,
    )


def check_query(query: ObjectQuery) -> None:
    """Raise if a query is invalid.

    Raises:
        InvalidInputError: A kind, a bound or the limit is invalid.
    """
    for kind in query.kinds:
        if kind not in KINDS:
            raise InvalidInputError("kinds", kind, one_of(KINDS, kind))
    if not 1 <= query.limit <= MAX_OBJECTS:
        raise InvalidInputError("limit", query.limit, f"1 to {MAX_OBJECTS}")
    for name, corner in (("low_m", query.low_m), ("high_m", query.high_m)):
        if corner is not None and (len(corner) != 3 or np.isnan(corner).any()):
            raise InvalidInputError(name, list(corner), "x, y and z")


def page_of(
    things: Iterable[ObjectInstances], labels: Mapping[int, str], query: ObjectQuery
) -> ObjectPage:
    """Return the objects that the query selects, in the order of their instance ids.

    Args:
        labels: Names by semantic id.
    """
    chosen = [(each, np.flatnonzero(_passes(each, query))) for each in things]
    chosen = [(each, rows) for each, rows in chosen if len(rows)]
    if not chosen:
        return ObjectPage((), 0, 0)
    ids = np.concatenate([each.instance_ids[rows] for each, rows in chosen]).astype(np.int64)
    part = np.repeat(np.arange(len(chosen)), [len(rows) for _, rows in chosen])
    row = np.concatenate([rows for _, rows in chosen])
    order = np.argsort(ids, kind="stable")
    rest = order[ids[order] > query.after_instance_id]
    page = rest[: query.limit]
    objects = [_object(chosen[part[i]][0], int(row[i]), labels) for i in page]
    more = len(rest) > len(page)
    return ObjectPage(tuple(objects), len(ids), objects[-1].instance_id if more else 0)


def _passes(each: ObjectInstances, query: ObjectQuery) -> NDArray[np.bool_]:
    """Return (N,) which instances a query selects."""
    count = len(each.instance_ids)
    if (query.kinds and each.kind not in query.kinds) or (
        query.groups and each.group not in query.groups
    ):
        return np.zeros(count, bool)
    passes = np.ones(count, bool)
    if query.instance_ids:
        passes &= np.isin(each.instance_ids, np.array(query.instance_ids, np.int64))
    if query.names:
        passes &= np.isin(each.instance_ids, _ids_of_names(each, query.names))
    position_m = each.T_map_object[:, :3, 3]
    if query.low_m is not None:
        passes &= (position_m >= np.asarray(query.low_m)).all(axis=1)
    if query.high_m is not None:
        passes &= (position_m <= np.asarray(query.high_m)).all(axis=1)
    return passes


def _ids_of_names(each: ObjectInstances, names: Iterable[str]) -> NDArray[np.int64]:
    """Return the ids of the instances that have one of the names."""
    wanted = set(names)
    numbers = (name.rpartition("_")[2] for name in wanted)
    candidates = {int(number) for number in numbers if number.isdecimal() and len(number) < 12}
    candidates |= each.names.keys()
    return np.array([i for i in sorted(candidates) if each.name_of(i) in wanted], np.int64)


def _object(each: ObjectInstances, row: int, labels: Mapping[int, str]) -> SceneObject:
    T = each.T_map_object[row]
    scale = float(np.linalg.norm(T[:3, 0]))
    # The bounding box of a rotated box: its half edges by the absolute rotation matrix.
    centre_m = T[:3, :3] @ ((each.low_m + each.high_m) / 2) + T[:3, 3]
    half_m = np.abs(T[:3, :3]) @ ((each.high_m - each.low_m) / 2)
    instance_id = int(each.instance_ids[row])
    return SceneObject(
        instance_id=instance_id,
        name=each.name_of(instance_id),
        kind=each.kind,
        group=each.group,
        label=labels.get(each.semantic_id, ""),
        semantic_id=each.semantic_id,
        pose=pose_from_matrix(transform(T[:3, :3] / scale, T[:3, 3])),
        scale=scale,
        low_m=_triple(centre_m - half_m),
        high_m=_triple(centre_m + half_m),
        box_low_m=_triple(scale * each.low_m),
        box_high_m=_triple(scale * each.high_m),
    )


def _triple(vector: FloatArray) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z
