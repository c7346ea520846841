"""Writes what workers print to log files of bounded size."""

from __future__ import annotations

import contextlib
import logging
import os
import re
from io import TextIOWrapper
from logging.handlers import RotatingFileHandler
from pathlib import Path

from oaisys_core.system.private_files import PRIVATE_FOLDER, open_private

_LOG = logging.getLogger(__name__)
_FILE_BYTES = 5_000_000
_OLD_FILES = 2
_LOGS_KEPT = 40
"""Log files of all servers on this machine; each port has its own."""


def state_folder() -> Path | None:
    """Return the folder for state that outlives a run, by the XDG specification.

    None, with a warning, for a user without a home, such as a number that a container was given.
    """
    base = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
    try:
        return Path(base).expanduser() / "oaisys"
    except RuntimeError as error:
        _LOG.warning("what workers print is not kept, see --worker-log: %s", error)
        return None


class WorkerLog:
    """One file for all workers of a server; safe to use from any thread."""

    def __init__(self) -> None:
        self._logger = logging.Logger("worker")  # noqa: LOG001 - nobody else logs here
        self.path: Path | None = None

    def open(self, folder: Path, address: str) -> None:
        """Start to write to a file named after the server's address; older files are kept."""
        name = re.sub(r"[^A-Za-z0-9.]+", "-", address).strip("-")
        path = folder / f"worker-{name}.log"
        try:
            folder.mkdir(PRIVATE_FOLDER, parents=True, exist_ok=True)
            _forget_old(folder)
            handler = _Handler(path, maxBytes=_FILE_BYTES, backupCount=_OLD_FILES)
        except OSError as error:
            _LOG.warning("what workers print is not kept: %s", error)
            return
        handler.setFormatter(logging.Formatter("%(asctime)s %(message)s"))
        self._logger.addHandler(handler)
        self.path = path

    def write(self, pid: int, line: str) -> None:
        """Write a line that the worker with this process id printed."""
        self._logger.info("%d %s", pid, line)

    def close(self) -> None:
        """Close the file."""
        for handler in list(self._logger.handlers):
            self._logger.removeHandler(handler)
            handler.close()


class _Handler(RotatingFileHandler):
    def _open(self) -> TextIOWrapper:
        """Open the file for this user alone, and no link that somebody has put in its place."""
        descriptor = open_private(Path(self.baseFilename), os.O_WRONLY | os.O_APPEND)
        return os.fdopen(descriptor, "a", encoding="utf-8", errors="backslashreplace")

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - logging's name
        """Drop the line: a full disk must not disturb the server."""


def _forget_old(folder: Path) -> None:
    written = {}
    for log in folder.glob("worker-*.log*"):
        with contextlib.suppress(FileNotFoundError):  # another server forgets, too
            written[log] = log.stat().st_mtime
    for log in sorted(written, key=lambda log: written[log])[:-_LOGS_KEPT]:
        log.unlink(missing_ok=True)
