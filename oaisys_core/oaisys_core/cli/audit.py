"""The shell command ``oaisys audit``."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from oaisys_core.cli.options import (
    BackendOption,
    ConfigOption,
    QualityOption,
    SeedOption,
    SizeOption,
)
from oaisys_core.cli.standard_output import own_stdout
from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_core.files.whole_files import check_output_file

if TYPE_CHECKING:
    from rich.table import Table

    from oaisys_core.config import SimulationConfig
    from oaisys_core.verification.audit import AuditResult
    from oaisys_core.verification.light.light_figure import LightFigure

LARGEST_WRONG_SHARE = 5e-4


class AuditFailedError(OaisysError):
    """A modality has more wrong pixels than allowed."""


def audit(
    config: ConfigOption = None,
    views: Annotated[int, typer.Option(help="Number of random views of each world.", min=1)] = 10,
    batches: Annotated[int, typer.Option(help="Number of worlds.", min=1)] = 1,
    seed: SeedOption = None,
    backend: BackendOption = None,
    quality: QualityOption = None,
    size: SizeOption = None,
    limit: Annotated[
        float,
        typer.Option(help="Largest allowed share of wrong pixels away from edges.", min=0, max=1),
    ] = LARGEST_WRONG_SHARE,
    light: Annotated[
        bool,
        typer.Option(
            "--light",
            help="Audit light instead: grey patches under known light against formulas. Of the"
            " configuration only the backend counts.",
        ),
    ] = False,
    out: Annotated[Path | None, typer.Option(help="JSON file for the figures.")] = None,
) -> None:
    """Compare depth and labels of random views with an independent ray cast.

    Exit code 1 if the share of wrong pixels away from edges exceeds the limit, or with --light, if
    a figure is off by more than its limit.
    """
    # `oaisys --help` imports this module, so slow imports are done on use.
    from rich.console import Console

    from oaisys_core.config import SimulationConfig, adjust, load_config

    loaded = load_config(config) if config else SimulationConfig()
    chosen = adjust(loaded, seed=seed, backend=backend, quality=quality, size=size)
    if out is not None:
        check_output_file(out)
    if light:
        _audit_light(chosen.backend, out)
        return
    with own_stdout():
        found = _audit(chosen, batches, views)
    figures = [
        {
            "sensor": f.sensor,
            "modality": f.modality,
            "pixels": f.pixels,
            "wrong": f.wrong,
            "wrong_share": f.wrong_share,
            "worst_m": f.worst_m,
        }
        for f in found
    ]
    if out is not None:
        from oaisys_core.output.files import write_text

        write_text(out, json.dumps(figures, indent=2) + "\n")
    Console().print(_table(found))
    worst = max(found, key=lambda f: f.wrong_share)
    if worst.wrong_share > limit:
        raise AuditFailedError(
            f"{worst.sensor}/{worst.modality}: {worst.wrong_share:.4%} of the pixels off edges are"
            f" wrong, expected at most {limit:.4%}"
        )
    for f in found:
        if not f.pixels:
            expected = f"views in which {f.sensor}/{f.modality} has pixels off edges to compare"
            raise InvalidInputError("views", views, expected)


def _audit_light(backend_name: str, out: Path | None) -> None:
    """Print the figures of the audit of light, and write them to a file.

    Raises:
        AuditFailedError: A figure misses its limit.
    """
    from rich.console import Console

    with own_stdout():
        found, version = _light_figures(backend_name)
    if out is not None:
        from oaisys_core.output.files import write_text

        renderer = {"backend": backend_name, "backend_version": version}
        figures = [{**asdict(f), "error": f.error, "is_met": f.is_met, **renderer} for f in found]
        write_text(out, json.dumps(figures, indent=2) + "\n")
    Console().print(_light_table(found))
    missed = [f.name for f in found if not f.is_met]
    if missed:
        raise AuditFailedError(f"{len(missed)} of {len(found)} figures miss: {'; '.join(missed)}")


def _light_figures(backend_name: str) -> tuple[list[LightFigure], str]:
    """Return the figures, and the version of the backend."""
    from oaisys_core.render import make_backend
    from oaisys_core.system.progress_display import ProgressDisplay
    from oaisys_core.verification.light.checks import CHECKS, figures

    backend = make_backend(backend_name)
    # Without Blender, only drafts have shadows and the laws of reflection.
    quality = "draft" if backend_name == "analytic" else "audit"
    try:
        with ProgressDisplay("auditing", len(CHECKS)) as display:
            return figures(backend, quality, display.advance), backend.version
    finally:
        backend.close()


def _light_table(found: list[LightFigure]) -> Table:
    from rich.table import Table

    table = Table("light", "measured", "formula", "error", "limit", "")
    for f in found:
        numbers = f"{f.measured:.5g}", f"{f.expected:.5g}", f"{f.error:+.3%}", f"{f.limit:.0%}"
        table.add_row(f.name, *numbers, "" if f.is_met else "MISSED")
    return table


def _audit(config: SimulationConfig, batches: int, views: int) -> list[AuditResult]:
    import numpy as np

    from oaisys_core.simulation import Simulation
    from oaisys_core.system.progress_display import ProgressDisplay
    from oaisys_core.types import ModuleMetadata
    from oaisys_core.verification.audit import audit_views, is_audited, sum_results

    _check_cameras(config)
    simulation = Simulation(config)
    found: list[AuditResult] = []
    try:
        offered = {name for each in simulation.info().sensors for name in each.modalities}
        rendered = sorted(filter(config.render.renders, offered))
        if not any(map(is_audited, rendered)):
            expected = "depth, instance or semantic_N: there are no depth or labels to audit"
            raise InvalidInputError("render.passes", rendered, expected)
        with ProgressDisplay("auditing", batches * views) as display:
            for batch in range(batches):
                # Audit the ground truth, whatever sensors.faults says.
                simulation.step_batch(ModuleMetadata(sensor={"faults": {"enabled": False}}))
                rng = np.random.default_rng([config.seed, batch])
                found += audit_views(simulation, views, rng, lambda _: display.advance())
    finally:
        simulation.close()
    if not found:
        expected = "so many that a camera is due (sensors.cameras: step_offset, step_interval)"
        raise InvalidInputError("views", views, expected)
    return sum_results(found)


def _check_cameras(config: SimulationConfig) -> None:
    """Raise if views of a camera cannot be compared."""
    from oaisys_core.verification.audit import LEAST_EDGE_PX

    for camera in config.sensors.all_cameras:
        if camera.readout_s:
            expected = "0: views are compared with those of cameras that stand still"
            raise InvalidInputError(f"{camera.name}: readout_s", camera.readout_s, expected)
        size_px = (camera.width_px, camera.height_px)
        if min(size_px) < LEAST_EDGE_PX:
            expected = f"at least {LEAST_EDGE_PX} x {LEAST_EDGE_PX} pixels, some of them off edges"
            raise InvalidInputError(f"{camera.name}: width_px, height_px", size_px, expected)


def _table(found: list[AuditResult]) -> Table:
    from rich.table import Table

    table = Table("sensor", "modality", "pixels off edges", "wrong", "share", "worst error")
    for f in found:
        worst = f"{f.worst_m * 1000:.3f} mm" if f.modality == "depth" else ""
        table.add_row(
            f.sensor, f.modality, f"{f.pixels:,}", f"{f.wrong:,}", f"{f.wrong_share:.4%}", worst
        )
    return table
