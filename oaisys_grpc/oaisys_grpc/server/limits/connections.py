"""How many connections and calls gRPC itself lets in, and when it closes a connection."""

from __future__ import annotations

import resource

from oaisys_core.errors import OaisysError

STREAMS_OF_CONNECTION = 100
"""Calls at a time by one connection; gRPC's clients wait until one has ended."""

MAX_CONNECTIONS = 256
"""Connections at a time; others are closed at once."""

MIN_FILES, MAX_FILES = 128, 4096
"""Files that a server must be allowed to open, and as many as it asks for."""

_OWN_FILES = 96
"""Of these, for the worker and the samples that are kept."""

_CONNECTION_OPTIONS = (
    # A client that has stopped, or whose machine is gone, is noticed within 40 s.
    ("grpc.keepalive_time_ms", 10_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    # Unset, gRPC waits for the answer to a ping for a minute, whatever the line above says.
    ("grpc.http2.ping_timeout_ms", 10_000),
    ("grpc.keepalive_permit_without_calls", 1),
    # Clients may send keepalive pings as often.
    ("grpc.http2.min_ping_interval_without_data_ms", 5_000),
    ("grpc.server_handshake_timeout_ms", 10_000),
    ("grpc.max_concurrent_streams", STREAMS_OF_CONNECTION),
    # By default, gRPC ends any client's calls where a thousand wait to be looked at.
    ("grpc.server.max_pending_requests", STREAMS_OF_CONNECTION * MAX_CONNECTIONS),
    ("grpc.server.max_pending_requests_hard_limit", STREAMS_OF_CONNECTION * MAX_CONNECTIONS),
)


def connection_options() -> list[tuple[str, int]]:
    """Return the options for a server; descriptors are left for what is not a connection.

    Raises:
        OaisysError: This process may open too few files.
    """
    connections = min(MAX_CONNECTIONS, _files_allowed() - _OWN_FILES)
    return [*_CONNECTION_OPTIONS, ("grpc.max_allowed_incoming_connections", connections)]


def _files_allowed() -> int:
    """Return how many files this process may open, after having asked for as many as it may."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY and soft < MAX_FILES:
        soft = MAX_FILES if hard == resource.RLIM_INFINITY else min(MAX_FILES, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    if soft != resource.RLIM_INFINITY and soft < MIN_FILES:
        raise OaisysError(
            f"this process may open {soft} files, and a server needs {MIN_FILES}: ulimit -n"
        )
    return MAX_FILES if soft == resource.RLIM_INFINITY else soft
