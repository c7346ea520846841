"""Gather the pages of the site: `python -m tools.docs FOLDER`. `make docs` builds it from there."""

from __future__ import annotations

import sys
from pathlib import Path

from tools.docs.sources import gather_sources


def main() -> None:
    """Gather all pages in the folder that the command line names."""
    if len(sys.argv) != 2:
        sys.exit(f"docs: one folder is expected, received {sys.argv[1:]}")
    gather_sources(Path(sys.argv[1]))


if __name__ == "__main__":
    main()
