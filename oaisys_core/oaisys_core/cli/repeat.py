"""``oaisys repeat``: renders recorded samples again and compares the results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from oaisys_core.cli.standard_output import own_stdout
from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_core.files.documents import parse_json

if TYPE_CHECKING:
    from oaisys_core.config import SimulationConfig
    from oaisys_core.simulation import Simulation
    from oaisys_core.types import RecordedSample, Sample
    from oaisys_core.verification.recorded_samples import Comparison

MIN_PSNR_DB = 40.0


class DifferentSampleError(OaisysError):
    """A repeated sample differs from the recorded one."""


def repeat(
    record: Annotated[
        Path,
        typer.Argument(
            help="A sample's JSON file or the folder of `oaisys render`, or a bag (its folder or "
            "one .mcap file)."
        ),
    ],
    sample: Annotated[
        list[str] | None,
        typer.Option("--sample", help="BATCH/SAMPLE, may be repeated; default: the newest sample."),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Repeat all samples of the record.")] = False,
    config: Annotated[
        Path | None,
        typer.Option("--config", help="YAML file; default: the configuration in the record."),
    ] = None,
    least_psnr: Annotated[
        float, typer.Option(help="Least PSNR of colours, in dB.", min=0)
    ] = MIN_PSNR_DB,
) -> None:
    """Render recorded samples again from their provenance, and compare with what was recorded.

    Depth, labels, instance ids, normals and scans must be equal byte by byte, colours within
    --least-psnr.
    The configuration comes from the record or from --config; its hash must be the recorded one.
    Exit code 0: equal; 1: something differs; 2: the record cannot be used.
    """
    # `oaisys --help` imports this module, so slow imports are done on use.
    from oaisys_core.config import config_from_mapping, load_config
    from oaisys_core.simulation import Simulation
    from oaisys_core.verification.recorded_samples import choose_ids, open_records

    source = open_records(record)
    wanted = choose_ids(source, sample or (), every=every)
    recorded = None if config else source.config_json()
    if config is None and recorded is None:
        expected = (
            "--config FILE, because the record has no configuration (a bag has it if the topic "
            "oaisys_bridge/configuration is recorded, too)"
        )
        raise InvalidInputError("config", None, expected)
    chosen = load_config(config) if config else config_from_mapping(parse_json(recorded or "{}"))
    different = count = 0
    with own_stdout():
        simulation = Simulation(chosen)
        try:
            for each in source.read(wanted):
                different += not _repeat(simulation, each, chosen, least_psnr)
                count += 1
        finally:
            simulation.close()
    if count < len(wanted):
        raise InvalidInputError("record", str(record), f"{len(wanted)} samples, not {count}")
    if different:
        raise DifferentSampleError(f"{different} of {count} samples differ from the record")


def _repeat(
    simulation: Simulation, record: RecordedSample, config: SimulationConfig, least_psnr_db: float
) -> bool:
    """Render a sample again, print how it compares, and return whether it is the same."""
    from oaisys_core.config import config_sha256
    from oaisys_core.verification.recorded_samples import compare

    outline = record.outline
    how = outline.provenance
    if how.config_sha256 != config_sha256(config):
        expected = f"the configuration of sha256 {how.config_sha256}, as recorded (--config FILE)"
        raise InvalidInputError("config", f"sha256 {config_sha256(config)}", expected)
    again = simulation.repeat(outline)
    comparisons = compare(record, again, least_psnr_db)
    is_same = all(each.is_equal for each in comparisons)
    verdict = "equal" if is_same else "DIFFERENT"
    typer.echo(f"batch {outline.batch_id} sample {outline.sample_id}: {verdict}")
    for line in (*map(describe, comparisons), *_notes(record, again)):
        typer.echo(f"  {line}")
    return is_same


def describe(each: Comparison) -> str:
    """Return a comparison in words."""
    from oaisys_core.types import POINTS

    name = f"{each.name.sensor}/{each.name.modality}"
    what = "points" if each.name.modality == POINTS else "pixels"
    if not each.different_px:
        return f"{name}: equal, {each.pixels} {what}"
    text = f"{name}: {each.different_px} of {each.pixels} {what} differ"
    if each.psnr_db is not None:
        text += f", PSNR {each.psnr_db:.1f} dB"
        return text + (", within the tolerance" if each.is_equal else "")
    return text + (", not judged" if each.is_equal else "")


def _notes(record: RecordedSample, again: Sample) -> list[str]:
    """Return notes on what is not compared, and on another backend version or device."""
    from oaisys_core.types import POINTS

    recorded = {(frame.sensor, frame.modality) for frame in record.frames}
    recorded |= {(scan.sensor, scan.modality) for scan in record.scans}
    missing = [n for n in record.outline.frames if (n.sensor, n.modality) not in recorded]
    notes = [
        f"{name.sensor}/{name.modality}: "
        + ("scans in bags are not compared" if name.modality == POINTS else "not in the record")
        for name in missing
    ]
    then, now = record.outline.provenance, again.provenance
    for field in ("backend_version", "device"):
        before, here = getattr(then, field), getattr(now, field)
        if before != here:
            notes.append(f"note: {field} was {before}, here it is {here}")
    return notes
