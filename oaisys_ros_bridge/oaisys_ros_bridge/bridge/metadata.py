"""Metadata of modules in requests, and what of it waits for the next sample."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from oaisys_core.errors import (
    InvalidInputError,
    OaisysError,
    RenderError,
    WorkerLostError,
    one_of,
    one_of_keys,
)
from oaisys_core.files.documents import parse_plain_json
from oaisys_core.types import ModuleMetadata
from oaisys_grpc.contract.metadata import metadata_to_proto

MODULES = ("sensor", "environment", "asset", "render", "custom")
MAX_LOST_WORKERS = 2
"""Workers that may end with a sample of the same metadata before this is dropped: the first may
have been killed by somebody else."""

_VIEW_FIELDS = ("modalities", "sensors")
"""Fields of a request beside its metadata that the simulator may refuse."""


def metadata_of_module(module: str, metadata_json: str) -> ModuleMetadata:
    """Return the metadata of one module from a JSON object of its keys.

    Raises:
        InvalidInputError: Unknown module, or no JSON object.
    """
    if module not in MODULES:
        raise InvalidInputError("module", module, one_of(MODULES, module))
    return _metadata({module: json_object("metadata_json", metadata_json)})


def metadata_of_modules(metadata_json: str) -> ModuleMetadata | None:
    """Return metadata from a JSON object by module; None if the text is empty.

    Raises:
        InvalidInputError: No JSON object of JSON objects, or an unknown module.
    """
    if not metadata_json.strip():
        return None
    by_module = json_object("metadata_json", metadata_json)
    for module, part in by_module.items():
        if module not in MODULES:
            raise InvalidInputError(f"metadata_json.{module}", part, one_of_keys(MODULES, module))
        if not isinstance(part, dict):
            raise InvalidInputError(f"metadata_json.{module}", part, "a JSON object")
    return _metadata(by_module)


def json_object(field: str, text: str) -> dict[str, Any]:
    """Return the JSON object in a text of a request.

    Raises:
        InvalidInputError: It is none, or beyond the bounds of `parse_plain_json`.
    """
    try:
        value = parse_plain_json(text)
    except ValueError as error:
        raise InvalidInputError(field, text, f"a JSON object ({error})") from None
    if not isinstance(value, dict):
        raise InvalidInputError(field, text, "a JSON object")
    return value


def _metadata(by_module: dict[str, dict[str, Any]]) -> ModuleMetadata:
    if "pose" in by_module.get("sensor", {}):
        received = by_module["sensor"]["pose"]
        raise InvalidInputError("metadata_json.sensor.pose", received, "poses through set_pose")
    return ModuleMetadata(**by_module)


class PendingMetadata:
    """Metadata for the next sample; safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._metadata: ModuleMetadata | None = None
        self._lost_workers = 0

    def add(self, metadata: ModuleMetadata) -> None:
        """Merge metadata into what is pending; newer values win.

        Raises:
            InvalidInputError: All of it together cannot be sent; what was pending stays.
        """
        with self._lock:
            merged = (self._metadata or ModuleMetadata()).with_update(metadata)
            metadata_to_proto(merged)  # refuses what is too large or too deep
            self._metadata = merged

    @property
    def asset(self) -> ModuleMetadata | None:
        """The pending metadata of the asset module alone; None: nothing is pending."""
        with self._lock:
            metadata = self._metadata
        if metadata is None or not metadata.asset:
            return None
        return ModuleMetadata(asset=metadata.asset)

    def clear(self) -> None:
        """Drop all pending metadata."""
        with self._lock:
            self._metadata, self._lost_workers = None, 0

    @contextmanager
    def lend(self) -> Iterator[ModuleMetadata | None]:
        """Lend the pending metadata to a sample; it is pending again if the sample fails.

        Metadata that the simulator refuses, or with which it cannot render, is dropped: it would
        make every later sample fail. Of the latter, the error says so.
        """
        with self._lock:
            metadata, self._metadata = self._metadata, None
        try:
            yield metadata
        except OaisysError as error:
            if metadata is None or _is_refusal(error):
                raise
            if isinstance(error, RenderError | WorkerLostError) and self._is_to_blame(error):
                modules = ", ".join(name for name in MODULES if getattr(metadata, name))
                told = f"the metadata of {modules} that waited for this sample was dropped"
                raise type(error)(f"{error}; {told}") from error
            with self._lock:
                self._metadata = metadata.with_update(self._metadata or ModuleMetadata())
            raise
        self._lost_workers = 0

    def _is_to_blame(self, error: RenderError | WorkerLostError) -> bool:
        """Return whether the metadata may be what a sample failed by, and forget its failures."""
        with self._lock:
            self._lost_workers += isinstance(error, WorkerLostError)
            if isinstance(error, WorkerLostError) and self._lost_workers < MAX_LOST_WORKERS:
                return False
            self._lost_workers = 0
        return True


def _is_refusal(error: OaisysError) -> bool:
    """Return whether the simulator has refused the metadata of a sample, not its view."""
    if not isinstance(error, InvalidInputError):
        return False
    module, _, key = error.field.removeprefix("metadata.").partition(".")
    if error.field.startswith("metadata."):
        return module != "sensor" or key.split(".")[0] != "pose"
    return "pose" not in error.field and error.field not in _VIEW_FIELDS
