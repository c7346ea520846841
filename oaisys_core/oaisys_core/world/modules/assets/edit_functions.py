"""Functions that apply the edits in metadata to placements and primitives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene import Placement, Primitive
from oaisys_core.types import FloatArray
from oaisys_core.world.modules.assets.drawing import AssetPlacement
from oaisys_core.world.modules.assets.metadata import GroupEdit, ObjectEdit


def edit_placement(
    each: AssetPlacement, group: GroupEdit, edits: Sequence[tuple[int, ObjectEdit]]
) -> Placement:
    """Return a placement after edits of its group and of single instances."""
    placement = each.placement
    T_map_object = placement.T_map_object.copy()
    T_map_object[:, :3, :3] *= group.scale
    hidden = each.hidden if group.hidden is None else group.hidden
    is_shown = np.full(len(T_map_object), not hidden)
    row_of = {instance_id: row for row, instance_id in enumerate(placement.instance_ids.tolist())}
    for instance_id, edit in edits:
        row = row_of[instance_id]
        T_map_object[row] = edit_pose(T_map_object[row], edit)
        if edit.hidden is not None:
            is_shown[row] = not edit.hidden
    return without_hidden(replace(placement, T_map_object=T_map_object), is_shown)


def edit_pose(T_map_object: FloatArray, edit: ObjectEdit) -> FloatArray:
    """Return a (4, 4) pose with uniform scale after an edit."""
    from scipy.spatial.transform import Rotation

    T = T_map_object.copy()
    if edit.position_m is not None:
        T[:3, 3] = edit.position_m
    if edit.quat_xyzw is not None:
        size = float(np.linalg.norm(T[:3, 0]))
        T[:3, :3] = size * Rotation.from_quat(edit.quat_xyzw).as_matrix()
    T[:3, :3] *= edit.scale
    return T


def edit_primitives(
    primitives: tuple[Primitive, ...], edits: Mapping[int, ObjectEdit]
) -> tuple[Primitive, ...]:
    """Return the primitives after edits, without hidden ones; the same tuple without edits."""
    if not any(primitive.instance_id in edits for primitive in primitives):
        return primitives
    result = []
    for primitive in primitives:
        edit = edits.get(primitive.instance_id)
        if edit is None:
            result.append(primitive)
        elif not edit.hidden:
            pose = edit_pose(primitive.T_map_object, edit.model_copy(update={"scale": 1.0}))
            a, b, c = (size_m * edit.scale for size_m in primitive.size_m)
            result.append(replace(primitive, T_map_object=pose, size_m=(a, b, c)))
    return tuple(result)


def without_hidden(placement: Placement, is_shown: NDArray[np.bool_]) -> Placement:
    """Return a placement without its hidden instances, ``is_shown`` (N,); itself if none is."""
    if is_shown.all():
        return placement
    return replace(
        placement,
        T_map_object=placement.T_map_object[is_shown],
        instance_ids=placement.instance_ids[is_shown],
    )
