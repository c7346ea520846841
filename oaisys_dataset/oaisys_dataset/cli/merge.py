"""``oaisys dataset merge``: one data set of several."""

from __future__ import annotations

from typing import Annotated

import typer


def merge(
    places: Annotated[
        list[str],
        typer.Argument(metavar="DIR...", help="Folders or URLs of data sets.", show_default=False),
    ],
    out: Annotated[
        str, typer.Option(help="New folder or URL for the merged set.", show_default=False)
    ],
) -> None:
    """Write a data set with the worlds of all the data sets in DIR.

    Worlds keep their splits and all their bytes but numbers: those of the second and following sets
    come after those of the first, and are printed. Sets with other sensors, modalities or meanings
    of labels, or with a world in common, are refused.
    """
    # `oaisys --help` imports this module, so slow imports are done on use.
    from oaisys_core.system.progress_display import ProgressDisplay
    from oaisys_dataset.merging import merge_datasets
    from oaisys_dataset.reader import open_dataset

    with ProgressDisplay("merging worlds") as display:
        merged = merge_datasets(places, out, display.count)
    for each in merged:
        last, first = each.worlds - 1, each.first_world
        failed = f"; {each.failed} of them could not be made" if each.failed else ""
        of, now = (
            (f"s 0 to {last}", f"s {first} to {first + last}") if last else (" 0", f" {first}")
        )
        typer.echo(f"{each.place}: world{of} now world{now}{failed}")
    dataset = open_dataset(out)
    worlds, splits = len(dataset.worlds), ", ".join(dataset.splits)
    typer.echo(f"{out}: {worlds} worlds ({splits}), {len(dataset)} frames")
