"""The worlds of the panel, and the demo's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from oaisys_core.types import merge
from tools.bench.settings import CONFIG, Settings, camera

EXAMPLES = CONFIG.parent / "examples"

DEMO = "demo"
SIX_VIEWS = "six_views"
"""The six fixed views of the demo's world: a row of their own beside the panel."""

WORLDS: dict[str, Path] = {
    DEMO: CONFIG,
    "stage_canyon": EXAMPLES / "stage_canyon.yaml",
    "environment_mars": EXAMPLES / "environment_mars.yaml",
    "environment_moon": EXAMPLES / "environment_moon.yaml",
    "mountain": EXAMPLES / "mountain.yaml",
    "assets_vegetation": EXAMPLES / "assets_vegetation.yaml",
    "stage_dunes": EXAMPLES / "stage_dunes.yaml",
    "dense": Path(__file__).parent / "dense.yaml",
}
"""The panel's worlds and their files."""

QUICK_WORLDS = (DEMO, "stage_canyon", "assets_vegetation")


def world_mapping(settings: Settings, world: str = DEMO) -> dict[str, Any]:
    """Return a world's configuration at the run's image size, to be rendered on its device."""
    configured = yaml.safe_load(world_file(world).read_text(encoding="utf-8"))
    sized = merge(configured, camera(settings.width_px, settings.height_px))
    return merge(sized, {"render": {"device": settings.device}})


def world_file(world: str) -> Path:
    """Return the file of a world, or of the six views'."""
    return CONFIG if world == SIX_VIEWS else WORLDS[world]
