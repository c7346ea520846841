"""Maps: the TSDF beside plain Open3D, and choosing the next view of an exploration."""

from __future__ import annotations

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings

MAPPING_MS = {
    "integrate_ms": 60.0,
    "integrate_classes_ms": 60.0,
    "mesh_ms": 300.0,
    "last_mesh_ms": 300.0,
}
MAPPING_NOTES = {
    "integrate_ms": "one view, 10 cm voxels",
    "integrate_classes_ms": "the same with classes of voxels and cells",
    "mesh_ms": "after each of 30 views over 100 m x 100 m, all of the mesh so far",
    "last_mesh_ms": "the same when all 30 are in it",
    "whole_mesh_ms": "all 30 views, nothing kept of earlier meshes",
}

PLANNING_MS = {"score_200_ms": 1000.0}
PLANNING_NOTES = {
    "score_200_ms": "200 views of a half explored hill, 50 cm voxels, 20 m of depth",
    "next_view_ms": "all of it: candidates, ways to them, scores",
    "take_in_ms": "one view into the map that plans are made on",
}


def mapping(settings: Settings, say: Say) -> list[Figure]:
    """Return milliseconds, ours with their goals, Open3D's for comparison."""
    found = run_job("mapping.fusing", settings, say)
    return [
        figure(
            f"{'' if name == 'ours' else name + '_'}{kind}",
            "ms",
            values,
            Goal(MAPPING_MS[kind]) if name == "ours" and kind in MAPPING_MS else None,
            MAPPING_NOTES["whole_mesh_ms" if (name, kind) == ("open3d", "mesh_ms") else kind],
        )
        for name, each in found.items()
        for kind, values in each.items()
    ]


def planning(settings: Settings, say: Say) -> list[Figure]:
    """Return milliseconds, the scores' with their goal."""
    found = run_job("planning.next_view", settings, say)
    return [
        figure(
            name,
            "ms",
            values,
            Goal(PLANNING_MS[name]) if name in PLANNING_MS else None,
            PLANNING_NOTES[name],
        )
        for name, values in found.items()
    ]
