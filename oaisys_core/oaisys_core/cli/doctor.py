"""``oaisys doctor``: what a machine has, what is missing, and the line that installs it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from oaisys_core.system.machine_checks import Finding

SIGNS = {"ok": "ok", "optional": "--", "missing": "!!"}


def doctor(
    as_json: Annotated[
        bool, typer.Option("--json", help="Print a list of findings for programs.")
    ] = False,
    address: Annotated[
        str, typer.Option(help="HOST:PORT that `oaisys serve` would listen at.")
    ] = "127.0.0.1:50051",
) -> None:
    """Say what this machine has, what is missing, and the line that installs it.

    `!!` marks what the simulator needs, `--` what only some of its parts need. Exit code 1 if
    something that it needs is missing.
    """
    from oaisys_core.system.machine_checks import examine_machine

    findings = examine_machine(address)
    if as_json:
        typer.echo(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        typer.echo("\n".join(_lines(findings)))
    if any(finding.state == "missing" for finding in findings):
        raise typer.Exit(1)


def _lines(findings: Sequence[Finding]) -> list[str]:
    """Return a line for each finding, and one below it for what to do."""
    width = max(len(finding.name) for finding in findings)
    lines = []
    for finding in findings:
        lines.append(f"{SIGNS[finding.state]}  {finding.name:<{width}}  {finding.found}")
        if finding.remedy:
            lines.append(f"    {'':<{width}}  -> {finding.remedy}")
    return lines
