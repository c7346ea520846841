"""The ``oaisys`` command and the core's own sub-commands."""
