"""The pages of the Python API: which modules are for others, and what to read of each."""

from __future__ import annotations

from collections.abc import Iterator

MODULES = {
    "simulation": ("Simulation", ["oaisys_core.simulation"]),
    "types": ("Types", ["oaisys_core.types"]),
    "geometry": ("Geometry", ["oaisys_core.geometry"]),
    "configuration": ("Configuration", ["oaisys_core.config"]),
    "errors": ("Errors", ["oaisys_core.errors"]),
    "output": ("Files of samples", ["oaisys_core.output.writer", "oaisys_core.output.reader"]),
    "extensions": (
        "Extensions",
        [
            "oaisys_core.extensions",
            "oaisys_core.world.module",
            "oaisys_core.procedural.terrain.landform",
            "oaisys_core.procedural.environment.effects",
            "oaisys_core.render.geometry_pass",
            "oaisys_dataset.formats.base",
        ],
    ),
    "client": ("gRPC client", ["oaisys_grpc.client"]),
    "datasets": ("Data sets", ["oaisys_dataset.reader"]),
    "mapping": (
        "Mapping",
        [
            "oaisys_mapping.tsdf",
            "oaisys_mapping.distance_field",
            "oaisys_mapping.ground_grid",
            "oaisys_mapping.mesh",
        ],
    ),
    "evaluation": (
        "Evaluation",
        [
            "oaisys_mapping.evaluation.evaluate",
            "oaisys_mapping.evaluation.thresholds",
            "oaisys_mapping.evaluation.holes",
        ],
    ),
    "exploration": (
        "Exploration",
        ["oaisys_mapping.exploration.planner", "oaisys_mapping.exploration.planners"],
    ),
    "ros": (
        "ROS conversions and surveys",
        [
            "oaisys_ros_bridge.conversions",
            "oaisys_ros_bridge.experiments.survey.plan",
            "oaisys_ros_bridge.experiments.survey.survey",
        ],
    ),
}
"""Titles and modules of each page."""


def api_pages() -> Iterator[tuple[str, str]]:
    """Yield each page's place on the site and its Markdown, which mkdocstrings fills."""
    for name, (title, modules) in MODULES.items():
        parts = [f"# {title}\n", *(f"::: {module}\n" for module in modules)]
        yield f"reference/api/{name}.md", "\n".join(parts)
