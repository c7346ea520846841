"""How many times faster the presets are than one full render for each kind of image."""

from __future__ import annotations

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure, ratio
from tools.bench.settings import Say, Settings

FASTER = {"geometry": 150.0, "preview": 45.0, "standard": 18.0}


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return what the plain renders take, and the ratios; both measured in one process."""
    found = run_job("plain.against_presets", settings, say)
    note = f"{found['samples']} samples per pixel"
    views = found["views"]
    figures = [
        figure(f"plain_{kind}_s", "s", [view[kind] for view in views], note=note)
        for kind in views[0]
    ]
    totals = [sum(view.values()) for view in views]
    figures.append(figure("plain_s", "s", totals, note=f"all of them, {note}"))
    for preset, seconds in found["presets"].items():
        # With fewer samples, the ratios mean nothing.
        goal = None if settings.quick else Goal(FASTER[preset], at_least=True)
        figures.append(figure(f"beside_plain_{preset}_s", "s", seconds))
        figures.append(ratio(f"speedup_{preset}", totals, seconds, goal))
    return figures
