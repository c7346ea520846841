"""The program ``oaisys``: what a signal does is settled before anything else is imported."""

from __future__ import annotations

import sys

from oaisys_core.system.ending.signals import exit_at_signals

_WITHOUT_FOLDER = {"--help", "--version", "doctor"}
"""Words of a command line that needs no current folder."""


def main() -> None:
    """Run the command line and exit, see `oaisys_core.cli.main`."""
    exit_at_signals()
    from oaisys_core.errors import ShortageError
    from oaisys_core.system.ending.owner import follow_owner
    from oaisys_core.system.shortages import check_address_space, check_current_folder
    from oaisys_core.system.standard_streams import open_standard_streams

    follow_owner()
    open_standard_streams()
    try:
        check_address_space()
        if not _WITHOUT_FOLDER & {*sys.argv[1:]}:
            check_current_folder()
    except ShortageError as error:
        sys.exit(f"oaisys: {error}")
    try:
        from oaisys_core.cli.main import run_program
    except ModuleNotFoundError as error:
        if (error.name or "oaisys").startswith("oaisys"):
            raise
        # `pip install oaisys_core` alone is what readers of its files need.
        sys.exit(f"oaisys: {error}; pip install 'oaisys_core[simulator]' installs what it needs")
    run_program()
