"""Judges drawn worlds inside Blender."""

from __future__ import annotations

from pathlib import Path

# Comes before anything that loads Open3D.
import bpy  # noqa: F401
from drawn_worlds import drawn_world
from world_judge import Verdict, judge


def verdicts(seeds: list[int], folder: Path) -> dict[int, Verdict]:
    """Render drawn worlds, and return what is wrong with each."""
    return {seed: judge(drawn_world(seed, folder)) for seed in seeds}
