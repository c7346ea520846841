"""Surveys of several worlds, and a table of their figures."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

from rich.table import Table

from oaisys_ros_bridge.experiments.configuration import write_config
from oaisys_ros_bridge.experiments.options import seeds_of
from oaisys_ros_bridge.experiments.progress import Reporter, print_table
from oaisys_ros_bridge.experiments.survey.plan import SurveyOptions
from oaisys_ros_bridge.experiments.survey.survey import run_survey

SEEDS_FILE = "seeds.json"

COLUMNS = (
    ("RMSE, mm", "rmse_m", 1000, ".2f"),
    ("median, mm", "accuracy_median_m", 1000, ".2f"),
    ("offset, mm", "offset_m", 1000, ".2f"),
    ("completion", "completion_ratio", 1, ".5f"),
    ("F-score", "f_score", 1, ".5f"),
    ("holes", "hole_ratio", 1, ".5f"),
    ("in overlap", "overlap_hole_count", 1, ".0f"),
    ("least IoU", "least_iou", 1, ".4f"),
)
"""Heading, figure, factor and format."""


def run_seeds(options: SurveyOptions, reporter: Reporter, seeds: str) -> bool:
    """Survey several worlds, print a table, and return whether `went_well` holds for all.

    Raises:
        InvalidInputError: ``seeds`` is not what `seeds_of` reads.
        ConfigError: The configuration cannot be used.
        OaisysError: A process failed, or did not answer in time.
    """
    config = write_config(options)
    first = int(json.loads(config.read_text(encoding="utf-8"))["seed"])
    reports: list[dict[str, Any]] = []
    for seed in seeds_of(seeds, first):
        reporter.say(f"world {seed}")
        out = options.out / f"seed_{seed}"
        overrides = {**options.overrides, "seed": str(seed)}
        run_survey(replace(options, out=out, overrides=overrides), reporter)
        reports.append(json.loads((out / "report.json").read_text(encoding="utf-8")))
    (options.out / SEEDS_FILE).write_text(json.dumps(reports, indent=2), encoding="utf-8")
    print_table(seeds_table(reports))
    return all(went_well(report) for report in reports)


def went_well(report: dict[str, Any]) -> bool:
    """Return whether a survey's map is accepted, and all maps with deliberate faults rejected."""
    faults = report["faults"]
    is_right = all(one["rejected"] == (one["name"] != "none") for one in faults)
    return bool(report["closed"]) and is_right


def seeds_table(reports: list[dict[str, Any]]) -> Table:
    """Return the figures of surveys, each followed by those of its perturbation test."""
    table = Table("seed", "map", *(heading for heading, *_ in COLUMNS), "verdict")
    for report in reports:
        verdict = "accepted" if report["closed"] else "rejected"
        table.add_row(str(report["seed"]), "the mapper's", *_cells(report), verdict)
        _add_faults(table, report["faults"])
        table.add_section()
    return table


def faults_table(faults: list[dict[str, Any]]) -> Table:
    """Return the figures of a perturbation test."""
    table = Table("seed", "map", *(heading for heading, *_ in COLUMNS), "verdict")
    _add_faults(table, faults)
    return table


def _add_faults(table: Table, faults: list[dict[str, Any]]) -> None:
    for fault in faults:
        verdict = "rejected" if fault["rejected"] else "accepted"
        table.add_row("", fault["name"], *_cells(fault["figures"]), verdict)


def _cells(figures: dict[str, Any]) -> list[str]:
    return [
        "" if figures.get(name) is None else format(factor * figures[name], form)
        for _, name, factor, form in COLUMNS
    ]
