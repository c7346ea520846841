"""Mitsuba, which knows nothing of us, renders a small world's mesh; our radiance is the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blender_process import skip_without_blender

from tools.bench.child import run_job
from tools.bench.jobs.light_errors import errors, pixels_to_judge
from tools.bench.settings import Settings
from tools.bench.topics.light import RENDERERS, light_figures


@pytest.mark.long
@pytest.mark.blender
@pytest.mark.parametrize("renderer", RENDERERS)
def test_craters_are_as_bright_as_mitsuba_says(renderer: str, tmp_path: Path) -> None:
    skip_without_blender()
    backend, quality = RENDERERS[renderer]
    job: dict[str, Any] = {
        "world": "craters",
        "backend": backend,
        "quality": quality,
        "factor": 0.5,
    }
    found = run_job("light.compare", Settings(out=tmp_path), lambda _share, _text: None, **job)
    assert found["share"] > 0.3
    missed = [
        f"{each.name}: {each.median:.2f}" for each in light_figures("x", found) if not each.is_met
    ]
    assert not missed


def test_light_that_is_wrong_misses_and_edges_do_not_count() -> None:
    theirs = {
        "radiance": np.full((20, 30), 0.4),
        "depth_m": np.full((20, 30), 7.0),
        "is_object": np.zeros((20, 30)),
        "sun_share": np.ones((20, 30)),
    }
    theirs["sun_share"][:, 20:] = 0.0
    theirs["radiance"][:, 20:] = 0.1
    theirs["depth_m"][:3] = np.inf
    judged = pixels_to_judge(theirs)
    assert not judged[:, 18:22].any()
    assert not judged[:5].any()
    assert judged[6:, :17].all()
    assert judged[6:, 23:].all()

    blurred = theirs["radiance"].copy()
    blurred[:, 19:21] = 0.25
    found = errors(blurred, theirs)
    assert (found["mean"], found["p95"]) == pytest.approx((0.0, 0.0))

    def missed(ours: np.ndarray) -> set[str]:
        figures = light_figures("x", errors(ours, theirs))
        return {each.name for each in figures if each.is_met is False}

    assert missed(theirs["radiance"] * 1.015) == set()
    assert missed(theirs["radiance"] * 1.05) == {"x_mean", "x_p95"}
    speckled = theirs["radiance"].copy()
    speckled[::2] *= 1.06
    speckled[1::2] *= 0.94
    assert "x_p95" in missed(speckled)
