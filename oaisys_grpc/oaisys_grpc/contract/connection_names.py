"""What a server calls a connection: its turns, limits and losses are counted by this name."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from uuid import uuid4

CLIENT_KEY = "oaisys-client"
"""Metadata of each call: an id that a client draws for its connection."""

MAX_ID_CHARACTERS = 64

Entries = Iterable[tuple[Any, ...]]
"""Keys and values of a call's metadata."""


def new_client_entry() -> tuple[str, str]:
    """Return the metadata by which a server knows a connection."""
    return CLIENT_KEY, uuid4().hex


def connection_name(peer: str, metadata: Entries | None) -> str:
    """Return the name of a call's connection.

    gRPC calls all connections of a Unix socket "unix:". There, where all clients are programs of
    the server's own user, the client's id tells them apart. Elsewhere the id counts nothing: the
    clients could take any number of turns by it.

    Args:
        peer: The connection's other end, as gRPC says.
        metadata: Of the call.
    """
    if not peer.startswith("unix"):
        return peer
    ids = [entry[1] for entry in metadata or () if entry[0] == CLIENT_KEY]
    client = ids[0] if ids and isinstance(ids[0], str) else ""
    is_usable = client.isalnum() and client.isascii() and len(client) <= MAX_ID_CHARACTERS
    return f"unix:{client}" if is_usable else peer


def name_of(context: Any) -> str:
    """Return the name of the connection of a ``grpc.ServicerContext``."""
    return connection_name(context.peer(), context.invocation_metadata())
