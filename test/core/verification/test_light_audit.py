"""The audit of light: Cycles meets each formula, and what is wrong is found."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from math import cos, pi, sin
from pathlib import Path

import numpy as np
import pytest
from blender_process import in_blender
from scipy.integrate import dblquad, quad
from typer.testing import CliRunner

from oaisys_core.cli.main import app
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.scene import PlacedCamera
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import Frame, ProgressCallback, ignore_progress
from oaisys_core.verification.light import closed_forms
from oaisys_core.verification.light.checks import figures
from oaisys_core.verification.light.light_figure import LightFigure


def test_the_closed_forms_are_their_integrals() -> None:
    by_elevation, _ = quad(
        lambda e: 2 * pi * (0.2 * (1 - sin(e) ** 0.5) + sin(e) ** 0.5) * sin(e) * cos(e), 0, pi / 2
    )
    assert closed_forms.gradient_irradiance(1.0, 0.2) == pytest.approx(by_elevation, rel=1e-6)
    assert closed_forms.gradient_irradiance(1.0, 1 / 3, 1.0) == pytest.approx(7 * pi / 9)
    for offset in (-0.9, -0.2, 0.0, 0.5):
        # The part of the unit disc whose height over the centre exceeds minus the offset.
        area, _ = dblquad(
            lambda x, y: 1.0,
            -offset,
            1.0,
            lambda y: -((1 - y * y) ** 0.5),
            lambda y: (1 - y * y) ** 0.5,
        )
        share = closed_forms.visible_share_of_disc(np.array(offset))
        assert float(share) == pytest.approx(area / pi, abs=1e-6)
    assert closed_forms.rough_from_above(0.5, 1e-4, 0.4) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.long
@pytest.mark.blender
def test_cycles_meets_every_formula() -> None:
    found: list[LightFigure] = in_blender("light_audit.light_figures")
    assert len(found) == 37
    assert [f for f in found if not f.is_met] == []


def test_drafts_meet_every_formula() -> None:
    found = figures(AnalyticBackend(), "draft", lambda: None)
    assert len(found) == 37
    assert [f for f in found if not f.is_met] == []


class BrightBackend(AnalyticBackend):
    """Renders radiance that is 2 % too bright."""

    def render_all(
        self,
        cameras: Sequence[PlacedCamera],
        settings: RenderSettings,
        progress: ProgressCallback = ignore_progress,
    ) -> tuple[Frame, ...]:
        frames = super().render_all(cameras, settings, progress)
        return tuple(replace(each, data=each.data * np.float32(1.02)) for each in frames)


def test_light_that_is_too_bright_is_found() -> None:
    found = {f.name: f for f in figures(BrightBackend(), "draft", lambda: None)}
    for name in ("Lambert, slope 0°, sun at 30°", "white furnace", "point lamp 4 m above"):
        assert not found[name].is_met
        assert found[name].error == pytest.approx(0.02, abs=0.002)


def test_the_command_prints_figures_and_marks_misses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("oaisys_core.render.make_backend", lambda _: BrightBackend())
    out = tmp_path / "light.json"
    said = CliRunner().invoke(app, ["audit", "--light", "--backend", "analytic", "--out", str(out)])
    assert said.exit_code == 1
    assert "MISSED" in said.output
    written = {each["name"]: each for each in json.loads(out.read_text())}
    assert written["four times the exposure time"]["is_met"]
    assert not written["white furnace"]["is_met"]
    assert {each["backend"] for each in written.values()} == {"analytic"}
    assert all(each["backend_version"] for each in written.values())
