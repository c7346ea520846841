"""TSDF: integration of one frame, and the mesh of thirty, beside plain Open3D."""

from __future__ import annotations

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings

LIMITS_MS = {"integrate_ms": 60.0, "mesh_ms": 300.0}
NOTES = {
    "integrate_ms": "one view, 10 cm voxels",
    "mesh_ms": "the whole mesh of 30 views over 100 m x 100 m",
}


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return milliseconds, ours with their goals, Open3D's for comparison."""
    found = run_job("mapping.fusing", settings, say)
    return [
        figure(
            f"{'' if name == 'ours' else name + '_'}{kind}",
            "ms",
            values,
            Goal(LIMITS_MS[kind]) if name == "ours" else None,
            NOTES[kind],
        )
        for name, each in found.items()
        for kind, values in each.items()
    ]
