"""``python -m oaisys_core`` is the ``oaisys`` command."""

from oaisys_core.cli.program import main

if __name__ == "__main__":
    main()
