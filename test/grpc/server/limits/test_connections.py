"""Connections of clients that do not say hello to the end, or have vanished, are closed."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from certificates import Authority
from served_simulator import FLAT_WORLD, Server

StartServer = Callable[..., Server]

LOAD = 4.0
"""Factor on promised seconds for a machine that does other things beside."""

HANDSHAKE_S, KEEPALIVE_S = 10.0, 30.0
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


@pytest.mark.long
@pytest.mark.parametrize(
    "sent", [b"", b"\x16\x03\x01\x02\x00\x01"], ids=["nothing", "half a hello"]
)
def test_a_tls_handshake_that_does_not_end_is_ended(
    start_server: StartServer, tmp_path: Path, sent: bytes
) -> None:
    cert, key = Authority(tmp_path).pair("server")
    server = start_server(FLAT_WORLD, "--tls-cert", str(cert), "--tls-key", str(key))
    assert open_s(server.address, sent, LOAD * HANDSHAKE_S) < LOAD * HANDSHAKE_S


@pytest.mark.long
@pytest.mark.parametrize("sent", [b"", PREFACE[:9], PREFACE], ids=["nothing", "half", "preface"])
def test_a_connection_that_does_not_begin_is_ended(start_server: StartServer, sent: bytes) -> None:
    server = start_server(FLAT_WORLD)
    assert open_s(server.address, sent, LOAD * HANDSHAKE_S) < LOAD * HANDSHAKE_S


@pytest.mark.long
def test_a_client_that_answers_no_ping_is_taken_for_gone(start_server: StartServer) -> None:
    server = start_server(FLAT_WORLD)
    lasted_s = open_s(server.address, PREFACE + SETTINGS + SETTINGS_READ, LOAD * KEEPALIVE_S)
    assert HANDSHAKE_S < lasted_s < LOAD * KEEPALIVE_S
