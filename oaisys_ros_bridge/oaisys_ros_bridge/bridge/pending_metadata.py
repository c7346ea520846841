"""Metadata that waits for the next sample."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_core.types import ModuleMetadata


class PendingMetadata:
    """What was set since the last sample; safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._metadata: ModuleMetadata | None = None

    def add(self, metadata: ModuleMetadata) -> None:
        """Send this, too; it goes on top of what is there."""
        with self._lock:
            self._metadata = (self._metadata or ModuleMetadata()).updated(metadata)

    @property
    def asset(self) -> ModuleMetadata | None:
        """What waits for the things on the ground alone; None: nothing."""
        with self._lock:
            metadata = self._metadata
        if metadata is None or not metadata.asset:
            return None
        return ModuleMetadata(asset=metadata.asset)

    def clear(self) -> None:
        """Send nothing."""
        with self._lock:
            self._metadata = None

    @contextmanager
    def sent(self) -> Iterator[ModuleMetadata | None]:
        """Take what is there for a sample; it comes back where the sample fails.

        What the simulator refuses is forgotten: it would spoil every later sample.
        """
        with self._lock:
            metadata, self._metadata = self._metadata, None
        try:
            yield metadata
        except OaisysError as error:
            refused = isinstance(error, InvalidInputError) and "pose" not in error.field
            if metadata is not None and not refused:
                with self._lock:
                    self._metadata = metadata.updated(self._metadata or ModuleMetadata())
            raise
