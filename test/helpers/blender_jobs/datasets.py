"""Jobs that render data sets with Blender."""

from __future__ import annotations

from typing import Any

from small_datasets import SCANNED, render_dataset


def render(
    where: str, splits: dict[int, str], views: int, config: dict[str, Any] | None = None
) -> None:
    """Render small worlds with Blender, by default seen by a camera and lidars."""
    render_dataset(where, splits, views, {**(config or SCANNED), "backend": "blender"})
