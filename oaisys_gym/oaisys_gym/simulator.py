"""The simulator of an environment: one of its own, which ends with it, or one that serves."""

from __future__ import annotations

import os
import weakref
from collections.abc import Mapping
from contextlib import ExitStack
from datetime import date
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import yaml

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_core.geometry.poses import has_mask
from oaisys_core.system.owned_folders import OwnedFolder, remove_abandoned
from oaisys_core.system.processes import ManagedProcess
from oaisys_core.system.python_programs import python_command
from oaisys_core.system.socket_paths import socket_parent
from oaisys_grpc.client.simulator_client import SimulatorClient

DEFAULT_WORLDS = Path(__file__).with_name("worlds") / "mounds.yaml"
"""The configuration where none is given."""

START_TIMEOUT_S = 180.0
"""How long a simulator may take until it serves."""

CALL_TIMEOUT_S = 120.0
"""How long a new world or a view may take."""

FOLDER_PREFIX = "oaisys-gym-"
"""Of the folder of a simulator that is started here."""

_SOCKET_BYTES = len(f"/{FOLDER_PREFIX}12345678/server")
_IMPORTED_IN = os.getpid()


class EpisodeSimulator:
    """A simulator in which episodes take place.

    Attributes:
        address: Where it serves.
        client: Its client.
        close: Ends the connection, and the simulator if it was started here. It is also called
            when this object is no longer used and when Python ends; a simulator whose owner is
            killed ends by itself, and removes its folder. In a fork of the process it does nothing.
    """

    def __init__(self, config: str | Path | Mapping[str, Any] | None, address: str) -> None:
        """Start a simulator, or connect to the one at ``address``.

        Args:
            config: YAML file or its content; None: `DEFAULT_WORLDS`. Ignored with an address.
            address: ``host:port`` or ``unix:PATH``; empty: start a simulator.

        Raises:
            InvalidInputError: An argument is of another type, or empty.
            OaisysError: The process ended, or does not serve in time; quotes its log.
        """
        if os.getpid() != _IMPORTED_IN:
            raise OaisysError(
                "this process was forked after gRPC had been imported, with which gRPC hangs: "
                'give the vector environment context="spawn"'
            )
        if not isinstance(address, str):
            raise InvalidInputError("address", address, "a text, such as 127.0.0.1:50051")
        if config is not None and (not isinstance(config, str | Path | Mapping) or config == ""):
            expected = "a YAML file, a dictionary, or None for the default worlds"
            raise InvalidInputError("config", config, expected)
        with ExitStack() as stack:
            if not address:
                address = _start(stack, config)
            self.address = address
            self.client = stack.enter_context(SimulatorClient(address, timeout_s=CALL_TIMEOUT_S))
            self.client.wait_ready(START_TIMEOUT_S)
            self.close = weakref.finalize(self, _close_own, os.getpid(), stack.pop_all())


def _close_own(process: int, stack: ExitStack) -> None:
    """End what a process has started, but not in a fork of it, whose parent still uses it."""
    if os.getpid() == process:
        stack.close()


def _plain(value: object, field: str) -> Any:
    """Return a value as YAML has it: numbers of NumPy as Python's, paths as texts.

    Raises:
        InvalidInputError: It has something else; names where.
    """
    if isinstance(value, Mapping):
        return {_plain(key, field): _plain(each, f"{field}.{key}") for key, each in value.items()}
    if has_mask(value):
        raise InvalidInputError(field, value, "numbers of which none is masked")
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(each, f"{field}.{index}") for index, each in enumerate(value)]
    if isinstance(value, PurePath | str):
        return str(value)
    if value is None or isinstance(value, bool | int | float | date):
        return value
    raise InvalidInputError(field, value, "a number, a text, a list, a dictionary or None")


def _start(stack: ExitStack, config: str | Path | Mapping[str, Any] | None) -> str:
    """Start a simulator that ``stack`` ends; return its address."""
    parent = socket_parent(_SOCKET_BYTES)
    remove_abandoned(FOLDER_PREFIX, parent)
    folder = stack.enter_context(OwnedFolder(FOLDER_PREFIX, parent)).path
    if isinstance(config, Mapping):
        file = folder / "worlds.yaml"
        file.write_text(yaml.safe_dump(_plain(config, "config")), encoding="utf-8")
    else:
        file = DEFAULT_WORLDS if config is None else Path(config)
    address = f"unix:{folder}/server"
    command = python_command("oaisys_grpc", "serve", "--config", str(file), "--address", address)
    server = stack.enter_context(
        ManagedProcess("the simulator", command, folder / "server.log", os.environ)
    )
    server.wait_for_line("ready:", START_TIMEOUT_S)
    return address
