"""``python -m oaisys_grpc serve`` is ``oaisys serve``, also where no command is installed."""

from oaisys_core.cli.program import main

if __name__ == "__main__":
    main()
