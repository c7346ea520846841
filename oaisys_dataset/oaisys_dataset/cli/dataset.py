"""``oaisys dataset``: data sets of many worlds.

``oaisys --help`` imports this module, so slow imports are done on use.
"""

from __future__ import annotations

import typer

from oaisys_dataset.cli.check import check
from oaisys_dataset.cli.export import describe, export
from oaisys_dataset.cli.merge import merge
from oaisys_dataset.cli.render import render, repeat

dataset_app = typer.Typer(
    help="Render, merge, check and export data sets of many worlds.",
    no_args_is_help=True,
    add_completion=False,
)
dataset_app.command("render")(render)
dataset_app.command("repeat")(repeat)
dataset_app.command("merge")(merge)
dataset_app.command("check")(check)
dataset_app.command("export")(export)
dataset_app.command("describe")(describe)
