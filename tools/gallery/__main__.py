"""Renders the gallery: ``python -m tools.gallery --out DIR``; ``make gallery`` does."""

from __future__ import annotations

import sys

from oaisys_core.system.ending.signals import work_in_child


def run() -> None:
    """Run the command in a child process, which a signal ends with nothing left."""
    if "--help" not in sys.argv:
        work_in_child("gallery")
    # Only now, as it loads Blender, which a process that forks must not have loaded.
    import typer

    from tools.gallery.gallery import main

    typer.run(main)


if __name__ == "__main__":
    run()
