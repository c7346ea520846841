"""Shows progress and tables, and writes ``bench.json``, ``bench.md`` and the plots."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console, JustifyMethod
from rich.status import Status
from rich.table import Table

from tools.bench.figures import Figure, write_json, write_text
from tools.bench.panel_table import COLUMNS as PANEL_COLUMNS
from tools.bench.panel_table import HEADINGS as PANEL_HEADINGS
from tools.bench.panel_table import panel_rows
from tools.bench.plots import plot_growth, plot_quality
from tools.bench.settings import Settings
from tools.bench.topics import quality

HEADINGS = ("figure", "median", "min", "max", "n", "unit", "goal", "")
DIGITS = 4
NEARLY_ALL = 99.9
"""Percentages above it are shown with more decimals."""

QUIET_S = 5.0
"""Between two lines with the same text, without a terminal."""

RELIABLE_SHARE = 0.15
"""From this share of a topic on, the time left is extrapolated from its pace."""


class TopicProgress:
    """Shows progress as a status line on a terminal, as plain lines elsewhere.

    Args:
        console: Output.
        expected_s: Expected seconds of each topic, in order.
    """

    def __init__(self, console: Console, expected_s: Mapping[str, float]) -> None:
        self._console = console
        self._expected_s = dict(expected_s)
        self._topic = ""
        self._started_s = 0.0
        self._said, self._said_s = "", 0.0
        self._status: Status | None = console.status("") if console.is_terminal else None

    def begin(self, topic: str) -> None:
        """Begin a topic."""
        self._topic = topic
        self._started_s = time.monotonic()
        if self._status is not None:
            self._status.start()

    def end(self) -> float:
        """End the topic and return the seconds that it took."""
        del self._expected_s[self._topic]
        if self._status is not None:
            self._status.stop()
        return time.monotonic() - self._started_s

    def say(self, share: float, text: str) -> None:
        """Show the share of the topic that is done, 0 to 1, and what comes next."""
        minutes = self.remaining_s(share) / 60
        line = f"{self._topic}, {100 * share:.0f} %, {minutes:.0f} min left: {text}"
        if self._status is not None:
            self._status.update(line)
        elif text != self._said or time.monotonic() - self._said_s > QUIET_S:
            self._said, self._said_s = text, time.monotonic()
            self._console.print(line, highlight=False)

    def remaining_s(self, share: float) -> float:
        """Return the expected seconds until all topics are done."""
        expected_s = self._expected_s[self._topic]
        if share > RELIABLE_SHARE:
            expected_s = (time.monotonic() - self._started_s) / share
        others_s = sum(self._expected_s.values()) - self._expected_s[self._topic]
        return expected_s * (1 - share) + others_s


def write_results(
    settings: Settings,
    machine: Mapping[str, str],
    by_topic: Mapping[str, Sequence[Figure]],
    failures: Mapping[str, str],
) -> None:
    """Write all figures so far."""
    figures = [figure for topic in by_topic.values() for figure in topic]
    write_json(settings.out / "bench.json", [figure.to_dict() for figure in figures])
    write_json(settings.out / "machine.json", dict(machine))
    points = quality.points(by_topic.get("quality", ()))
    plots = []
    if points:
        plots.append(plot_quality(points, settings.out / "quality.png"))
    if any(figure.curve for figure in figures):
        plots.append(plot_growth(figures, settings.out / "growth.png"))
    page = markdown(settings, machine, by_topic, failures, plots)
    write_text(settings.out / "bench.md", page)


def markdown(
    settings: Settings,
    machine: Mapping[str, str],
    by_topic: Mapping[str, Sequence[Figure]],
    failures: Mapping[str, str],
    plots: Sequence[Path],
) -> str:
    """Return the page that shows the figures."""
    lines = ["# Benchmarks", ""]
    if settings.quick:
        lines += ["**A quick look** (`--quick`): fewer values, references of fewer samples.", ""]
    lines += [f"* {name}: {value}" for name, value in machine.items()]
    lines += [f"* image: {settings.width_px}x{settings.height_px}"]
    lines += [f"* device: {settings.device}", f"* seed of random views: {settings.views_seed}", ""]
    for topic, figures in by_topic.items():
        lines += [f"## {topic}", ""]
        if panel := panel_rows(figures):
            lines += [*_table(PANEL_HEADINGS, panel), ""]
        lines += [*_table(HEADINGS, [cells(figure) for figure in figures]), ""]
    for topic, failure in failures.items():
        lines += [f"## {topic}: failed", "", "```", failure, "```", ""]
    lines += [f"![{plot.stem}]({plot.name})" for plot in plots]
    return "\n".join(lines) + "\n"


def cells(figure: Figure) -> list[str]:
    """Return a figure's row of the table."""
    goal = "" if figure.goal is None else str(figure.goal)
    verdict = {None: "", True: "met", False: "missed"}[figure.is_met]
    remarks = ", ".join(filter(None, (verdict, figure.note)))
    numbers = (figure.median, min(figure.values), max(figure.values))
    return [
        figure.name,
        *map(round_digits, numbers),
        str(len(figure.values)),
        figure.unit,
        goal,
        remarks,
    ]


def round_digits(value: float) -> str:
    """Return a number with few digits, none of them an exponent's."""
    if NEARLY_ALL < value < 100:
        return f"{value:.{DIGITS}f}"
    if abs(value) >= 10 ** (DIGITS - 1):
        return f"{value:.0f}"
    return f"{value:.{DIGITS}g}"


def print_table(console: Console, topic: str, figures: Sequence[Figure]) -> None:
    """Print a topic's figures; of the panel, a row for each world and the figures with goals."""
    if panel := panel_rows(figures):
        for columns in PANEL_COLUMNS:
            rows = Table(title=topic, title_justify="left")
            for column in columns:
                rows.add_column(PANEL_HEADINGS[column])
            for row in panel:
                rows.add_row(*(row[column] for column in columns))
            console.print(rows)
        figures = [figure for figure in figures if figure.goal is not None]
        if not figures:
            return
    table = Table(title=topic, title_justify="left")
    for heading in HEADINGS:
        justify: JustifyMethod = "right" if heading in HEADINGS[1:5] else "left"
        table.add_column(heading, justify=justify, no_wrap=heading != HEADINGS[-1])
    colors = {None: "", True: "green", False: "yellow"}
    for figure in figures:
        verdict = cells(figure)[-1].partition(",")[0] if figure.goal else ""
        table.add_row(*cells(figure)[:-1], verdict, style=colors[figure.is_met])
    console.print(table)


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [_row(headings), _row(["---"] * len(headings)), *map(_row, rows)]


def _row(values: Sequence[str]) -> str:
    return "| " + " | ".join(values) + " |"
