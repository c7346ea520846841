"""Connections of clients that do not say hello to the end, or have vanished, are closed."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from certificates import Authority
from served_simulator import FLAT_WORLD, Server

StartServer = Callable[..., Server]

LOAD = 4.0
"""Factor on promised seconds for a machine that does other things beside."""

HANDSHAKE_S, KEEPALIVE_S = 10.0, 40.0
PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
SETTINGS, SETTINGS_READ = b"\0\0\0\4\0\0\0\0\0", b"\0\0\0\4\1\0\0\0\0"


def open_s(address: str, sent: bytes, patience_s: float) -> float:
    """Send bytes, then only read, until the server closes the connection; return how long."""
    host, port = address.rsplit(":", 1)
    with socket.create_connection((host, int(port)), timeout=patience_s) as connection:
        connection.sendall(sent)
        begin_s = time.monotonic()
        try:
            while connection.recv(1 << 16):
                pass
        except ConnectionResetError:
            pass
        return time.monotonic() - begin_s


def all_open_s(address: str, sent: Sequence[bytes], patience_s: float) -> list[float]:
    """Return how long connections that begin at the same time last, see `open_s`."""
    with ThreadPoolExecutor(len(sent)) as pool:
        return list(pool.map(lambda each: open_s(address, each, patience_s), sent))


@pytest.mark.long
def test_a_tls_handshake_that_does_not_end_is_ended(
    start_server: StartServer, tmp_path: Path
) -> None:
    cert, key = Authority(tmp_path).pair("server")
    server = start_server(FLAT_WORLD, "--tls-cert", str(cert), "--tls-key", str(key))
    half_a_hello = b"\x16\x03\x01\x02\x00\x01"
    for lasted_s in all_open_s(server.address, [b"", half_a_hello], LOAD * HANDSHAKE_S):
        assert lasted_s < LOAD * HANDSHAKE_S


@pytest.mark.long
def test_connections_that_do_not_begin_or_answer_no_ping_are_ended(
    start_server: StartServer,
) -> None:
    server = start_server(FLAT_WORLD)
    begun = PREFACE + SETTINGS + SETTINGS_READ
    sent = [b"", PREFACE[:9], PREFACE, begun]
    *not_begun_s, begun_s = all_open_s(server.address, sent, LOAD * KEEPALIVE_S)
    for lasted_s in not_begun_s:
        assert lasted_s < LOAD * HANDSHAKE_S
    assert HANDSHAKE_S < begun_s < LOAD * KEEPALIVE_S
