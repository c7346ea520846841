"""What `oaisys --help` shows beside the options: groups of commands, and an example of each."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

GROUPS: Mapping[str, tuple[str, ...]] = {
    "See it": ("survey", "live", "view", "explore"),
    "Render": ("render", "dataset", "drive", "heights"),
    "Serve and record": ("serve", "record", "bag"),
    "Configure": ("config", "sensors", "place", "ros", "doctor"),
    "Check": ("audit", "evaluate", "certificate", "repeat"),
}
"""Titles, and the commands below each; those of other packages come last."""

OTHERS = "Further commands"

WIDTH = 72
"""Columns of an example's line, so that help fits into 80."""

_CONFIG = "config/examples"

EXAMPLES: Mapping[str, str] = {
    "oaisys": "oaisys survey --out out/survey",
    "oaisys audit": f"oaisys audit --config {_CONFIG}/mountain.yaml --views 5",
    "oaisys bag": "oaisys bag info out/survey/bag",
    "oaisys bag info": "oaisys bag info out/survey/bag",
    "oaisys bag recover": "oaisys bag recover cut_short_bag",
    "oaisys bag replay": "oaisys bag replay out/survey/bag",
    "oaisys certificate": "oaisys certificate check out/survey/certificate.json",
    "oaisys certificate challenge": "oaisys certificate challenge out/survey",
    "oaisys certificate check": "oaisys certificate check out/survey/certificate.json",
    "oaisys certificate issue": "oaisys certificate issue --out out/certificate",
    "oaisys certificate sign": "oaisys certificate sign out/survey/certificate.json --key key.pem",
    "oaisys config": f"oaisys config check {_CONFIG}/mountain.yaml",
    "oaisys config check": f"oaisys config check {_CONFIG}/mountain.yaml",
    "oaisys config import": "oaisys config import oaisys.json --out out/world.yaml",
    "oaisys config names": "oaisys config names --out out/names.md",
    "oaisys config reference": "oaisys config reference --out out/configuration.md",
    "oaisys config schema": "oaisys config schema --out out/schema.json",
    "oaisys config show": f"oaisys config show --config {_CONFIG}/mountain.yaml",
    "oaisys dataset": f"oaisys dataset render {_CONFIG}/dataset.yaml --worlds 20 --out out/dataset",
    "oaisys dataset check": "oaisys dataset check out/dataset",
    "oaisys dataset describe": "oaisys dataset describe out/dataset",
    "oaisys dataset export": "oaisys dataset export out/dataset --format coco --out out/coco",
    "oaisys dataset merge": "oaisys dataset merge out/dataset other_dataset --out out/both",
    "oaisys dataset render": (
        f"oaisys dataset render {_CONFIG}/dataset.yaml --worlds 20 --out out/dataset"
    ),
    "oaisys dataset repeat": "oaisys dataset repeat out/dataset 000000_0000_camera",
    "oaisys doctor": "oaisys doctor --json",
    "oaisys drive": f"oaisys drive --config {_CONFIG}/rover_drive.yaml --out out/drive",
    "oaisys drive plan": f"oaisys drive plan {_CONFIG}/rover_drive.yaml --out out/drive.csv",
    "oaisys evaluate": "oaisys evaluate --mesh out/survey/mesh.ply --truth out/survey/truth.ply",
    "oaisys explore": "oaisys explore --planner all --seeds 5 --out out/explore",
    "oaisys heights": f"oaisys heights --config {_CONFIG}/mountain.yaml --out out/heights.tif",
    "oaisys live": f"oaisys live --config {_CONFIG}/world_mars.yaml",
    "oaisys place": "oaisys place info site.tif",
    "oaisys place info": "oaisys place info site.tif --to-map 7.6586,45.9763",
    "oaisys record": "oaisys record --out out/bag",
    "oaisys render": "oaisys render --position -8 -6 6 --look-at 0 0 0 --out out/view",
    "oaisys repeat": "oaisys repeat out/survey/bag",
    "oaisys ros": "oaisys ros reference --out out/ros.md",
    "oaisys ros reference": "oaisys ros reference --out out/ros.md",
    "oaisys sensors": f"oaisys sensors import {_CONFIG}/assets/rover.urdf --out out/rover.yaml",
    "oaisys sensors import": (
        f"oaisys sensors import {_CONFIG}/assets/rover.urdf --out out/rover.yaml"
    ),
    "oaisys serve": f"oaisys serve --config {_CONFIG}/mountain.yaml --address 127.0.0.1:50051",
    "oaisys survey": "oaisys survey --backend analytic --out out/survey",
    "oaisys view": "oaisys view --address 127.0.0.1:50051",
}
"""One line that works as it is, by the command's full name.

What it reads from ``out`` another example writes; other files are of the one who reads the help.
"""


def add_examples(command: Any, path: str) -> None:
    """Let the help of a command, and of all that are part of it, end with its example."""
    if not command.epilog:
        command.epilog = epilog_of(path)
    for name, part in getattr(command, "commands", {}).items():
        add_examples(part, f"{path} {name}")


def epilog_of(path: str) -> str | None:
    """Return the last lines of a command's help; None where it has no example."""
    if path not in EXAMPLES:
        return None
    lines = textwrap.wrap(EXAMPLES[path], WIDTH, break_long_words=False, break_on_hyphens=False)
    return "\b\nExample:\n  " + " \\\n      ".join(lines)


def group_names(names: Sequence[str]) -> dict[str, list[str]]:
    """Return names of commands by the title of their group, in the order of `GROUPS`."""
    groups = {title: [name for name in group if name in names] for title, group in GROUPS.items()}
    known = {name for group in groups.values() for name in group}
    groups[OTHERS] = [name for name in names if name not in known]
    return {title: group for title, group in groups.items() if group}
