"""Jobs that render data sets with Blender."""

from __future__ import annotations

from small_datasets import SMALL, render_dataset


def render(where: str, splits: dict[int, str], views: int) -> None:
    """Render small worlds with Blender."""
    render_dataset(where, splits, views, {**SMALL, "backend": "blender"})
