"""Gather the pages of the site: `python -m tools.docs FOLDER`. `make docs` builds it from there."""

from __future__ import annotations

import argparse
from pathlib import Path

from tools.docs.sources import gather_sources


def main() -> None:
    """Gather all pages in the folder that the command line names."""
    parser = argparse.ArgumentParser(prog="python -m tools.docs", description=__doc__)
    parser.add_argument("folder", type=Path)
    gather_sources(parser.parse_args().folder)


if __name__ == "__main__":
    main()
