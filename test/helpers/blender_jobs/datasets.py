"""Jobs that render data sets with Blender."""

from __future__ import annotations

from small_datasets import SCANNED, render_dataset


def render(where: str, splits: dict[int, str], views: int) -> None:
    """Render small worlds with Blender, seen by a camera and lidars."""
    render_dataset(where, splits, views, {**SCANNED, "backend": "blender"})
