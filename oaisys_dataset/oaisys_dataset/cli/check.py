"""``oaisys dataset check``: is a data set whole, and does it show its worlds?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from oaisys_core.cli.standard_output import own_stdout
from oaisys_core.errors import OaisysError
from oaisys_core.files.whole_files import check_output_file

if TYPE_CHECKING:
    from oaisys_dataset.check import CheckReport

SHOWN = 20
"""Findings that are printed; the JSON report has more."""


class DatasetCheckFailedError(OaisysError):
    """Something is wrong with a data set."""


def check(
    dataset: Annotated[str, typer.Argument(help="Folder or URL of the data set.")],
    worlds_rebuilt: Annotated[
        int, typer.Option(help="Number of random worlds to make again and compare.", min=0)
    ] = 1,
    seed: Annotated[int, typer.Option(help="Draws these worlds, views and pixels.", min=0)] = 0,
    out: Annotated[Path | None, typer.Option(help="JSON file for the report.")] = None,
) -> None:
    """Check every file of a data set, and the images of some worlds against the worlds themselves.

    Exit code 0: nothing is wrong; 1: something is; 2: there is no data set.
    """
    # `oaisys --help` imports this module, so slow imports are done on use.
    from oaisys_core.output.records import write_json
    from oaisys_core.system.progress_display import ProgressDisplay
    from oaisys_dataset.check import check_dataset

    if out is not None:
        check_output_file(out)
    with own_stdout(), ProgressDisplay("checking worlds") as display:
        report = check_dataset(dataset, worlds_rebuilt, seed, display.count)
    if out is not None:
        write_json(out, report.as_json())
    typer.echo("\n".join(_lines(report)))
    if not report.has_passed:
        count = report.findings_total
        raise DatasetCheckFailedError(f"{dataset}: {count} finding{'s' if count > 1 else ''}")


def _lines(report: CheckReport) -> list[str]:
    splits = ", ".join(f"{count} {name}" for name, count in report.splits.items())
    counts = f"{report.frames} frames, {report.images} images, {report.image_bytes / 1e6:.1f} MB"
    counts += f", {report.scans} lidar scans" if report.scans else ""
    failed = f"{len(report.failed_worlds)} worlds failed"
    lines = [f"{report.worlds} worlds ({splits or 'none'}), {counts}; {failed}"]
    if report.rebuilt_worlds:
        worlds = ", ".join(map(str, report.rebuilt_worlds))
        lines.append(f"made again: world {worlds}; {report.points} points on its surface compared")
        if report.scan_points:
            lines.append(f"{report.scan_points} points of lidar scans compared likewise")
    lines += [
        f"{each.sensor}/{each.modality}: {each.wrong} of {each.pixels} pixels off edges are wrong"
        for each in report.audited
    ]
    lines += [f"note: {note}" for note in report.notes]
    shown = report.findings[:SHOWN]
    lines += [f"{finding.check}: {finding.subject}: {finding.text}" for finding in shown]
    if report.findings_total > len(shown):
        lines.append(f"... and {report.findings_total - len(shown)} more (--out FILE)")
    return lines
