"""The program ``oaisys``: what a signal does is settled before anything else is imported."""

from __future__ import annotations

from oaisys_core.system.owner import follow_owner
from oaisys_core.system.signals import exit_at_signals
from oaisys_core.system.standard_streams import open_standard_streams


def main() -> None:
    """Run the command line and exit, see `oaisys_core.cli.main`."""
    exit_at_signals()
    follow_owner()
    open_standard_streams()
    from oaisys_core.cli.main import run_program

    run_program()
