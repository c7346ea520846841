"""Drivers of Python in a .blend file: they are not run, and what they drive stays as saved."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy


def mute_python_drivers() -> list[str]:
    """Mute each driver that Blender would need Python for; return a warning for each.

    Blender takes 0 for what a script gives that it may not run: a scale would be 0. Simple
    expressions, which it evaluates by itself, stay.
    """
    warnings = []
    for owner, curve in _drivers():
        driver = curve.driver
        if driver.type == "SCRIPTED" and not driver.is_simple_expression and not curve.mute:
            curve.mute = True
            warnings.append(
                f"{owner.name!r}: the driver of {curve.data_path!r} is the Python"
                f" {driver.expression[:80]!r}, which is not run: the saved value stays"
            )
    return warnings


def _drivers() -> Iterator[tuple[Any, Any]]:
    """Yield each block of data, or tree of nodes within one, with a driver that it has."""
    for collection in bpy.data.bl_rna.properties:
        if collection.type != "COLLECTION":
            continue
        for block in getattr(bpy.data, collection.identifier):
            for owner in (block, getattr(block, "node_tree", None)):
                animation = getattr(owner, "animation_data", None)
                for curve in animation.drivers if animation is not None else ():
                    yield owner, curve
