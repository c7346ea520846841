"""TSDF: integration of one frame, and the mesh of thirty, beside plain Open3D."""

from __future__ import annotations

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings

LIMITS_MS = {
    "integrate_ms": 60.0,
    "integrate_classes_ms": 60.0,
    "mesh_ms": 300.0,
    "last_mesh_ms": 300.0,
}
NOTES = {
    "integrate_ms": "one view, 10 cm voxels",
    "integrate_classes_ms": "the same with classes of voxels and cells",
    "mesh_ms": "after each of 30 views over 100 m x 100 m, all of the mesh so far",
    "last_mesh_ms": "the same when all 30 are in it",
    "whole_mesh_ms": "all 30 views, nothing kept of earlier meshes",
}


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return milliseconds, ours with their goals, Open3D's for comparison."""
    found = run_job("mapping.fusing", settings, say)
    return [
        figure(
            f"{'' if name == 'ours' else name + '_'}{kind}",
            "ms",
            values,
            Goal(LIMITS_MS[kind]) if name == "ours" and kind in LIMITS_MS else None,
            NOTES["whole_mesh_ms" if (name, kind) == ("open3d", "mesh_ms") else kind],
        )
        for name, each in found.items()
        for kind, values in each.items()
    ]
