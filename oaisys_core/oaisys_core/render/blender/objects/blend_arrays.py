"""Triangles that the array modifiers in a .blend file would make, counted before they do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from oaisys_core.errors import quote
from oaisys_core.files.mesh_formats.mesh_headers import MAX_VERTICES

NEW_SHAPES = ("BOOLEAN", "BUILD", "DECIMATE", "MASK", "NODES", "REMESH", "SKIN", "WELD")
"""Types of modifiers after which a mesh may have few triangles, however many it had."""

LEAST_OFFSET = 1e-6
"""Of copies that fill a length; Blender refuses shorter ones."""

MOST_COUNTED = 10**18
"""Where counting ends: thousands of modifiers make numbers of thousands of digits."""

NAMED = 3
"""Number of modifiers that an error names."""


def too_many_triangles(things: Sequence[Any]) -> str | None:
    """Return what is expected instead of objects whose arrays have too many triangles."""
    counts = [_triangles_of(thing) for thing in things]
    total = sum(counts)
    if total <= MAX_VERTICES:
        return None
    largest = things[int(np.argmax(counts))]
    arrays = [modifier.name for modifier in _shown(largest) if modifier.type == "ARRAY"]
    named = ", ".join(map(quote, arrays[:NAMED])) + (", ..." if len(arrays) > NAMED else "")
    by_arrays = f", by its array modifiers {named}" if arrays else ""
    return (
        f"at most {MAX_VERTICES} triangles, not {total}, most of them of {quote(largest.name)}"
        f"{by_arrays}"
    )


def _shown(thing: Any) -> list[Any]:
    return [modifier for modifier in thing.modifiers if modifier.show_viewport]


def _triangles_of(thing: Any) -> int:
    """Return the most triangles that an object has while its arrays are evaluated."""
    count = most = len(thing.data.loops) - 2 * len(thing.data.polygons)
    for index, modifier in enumerate(_shown(thing)):
        if modifier.type == "ARRAY":
            copies = _copies(modifier, thing.data if index == 0 else None)
            count = min(count * copies, MOST_COUNTED)
        elif modifier.type in NEW_SHAPES:
            count = 1
        most = max(most, count)
    return most


def _copies(array: Any, mesh: Any) -> int:
    """Return how many copies an array makes; 1 where that is known only when it is evaluated.

    Args:
        array: The modifier.
        mesh: What it copies; None if earlier modifiers change it.
    """
    if array.fit_type == "FIXED_COUNT":
        return int(array.count)
    if array.fit_type != "FIT_LENGTH" or mesh is None or array.use_object_offset:
        return 1
    offset = np.zeros(3)
    if array.use_constant_offset:
        offset += array.constant_offset_displace
    if array.use_relative_offset:
        points = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", points)
        size = np.ptp(points.reshape(-1, 3).astype(np.float64), axis=0)
        offset += np.array(array.relative_offset_displace) * size
    length = float(np.linalg.norm(offset))
    if not length >= LEAST_OFFSET:
        return 1
    return int(min(array.fit_length / length, 2.0**31)) + 1
