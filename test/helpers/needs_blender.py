"""Tests that need Blender are skipped where it is not installed, and for no other reason."""

from __future__ import annotations

import importlib
import importlib.util

import pytest


def skip_without_blender(*, module: bool = False) -> None:
    """Skip the test, or the whole module, where there is no ``bpy``; nothing is imported."""
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("bpy is not installed", allow_module_level=module)


def require_blender() -> None:
    """As `skip_without_blender`; where there is a ``bpy`` it must import, else the test fails."""
    skip_without_blender()
    importlib.import_module("bpy")
