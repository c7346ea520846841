"""A connection that TLS does not let through says what to do, in client, bridge and command."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import grpc
import pytest
from certificates import Authority
from commands import oaisys
from waiting import PATIENCE_S

from oaisys_core.errors import DeadlineExceededError, NotReadyError
from oaisys_grpc.client.simulator_client import ClientTls, SimulatorClient
from oaisys_grpc.contract.faults import ServerUnavailableError
from oaisys_grpc.tls import ServerTls

ServedWith = Callable[[ServerTls | None], str]


@contextmanager
def port(tls: ServerTls | None, host: str = "127.0.0.1") -> Iterator[str]:
    """The address of a port that serves nothing but a handshake."""
    server = grpc.server(ThreadPoolExecutor(1))
    if tls is None:
        number = server.add_insecure_port(f"{host}:0")
    else:
        number = server.add_secure_port(f"{host}:0", tls.credentials())
    server.start()
    yield f"{host}:{number}"
    server.stop(None).wait()


@pytest.fixture
def served_with() -> Iterator[ServedWith]:
    with ExitStack() as stack:
        yield lambda tls: stack.enter_context(port(tls))


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority(tmp_path)


def said_by(address: str, tls: ClientTls | None) -> str:
    """What all ways of asking say; the same."""
    with SimulatorClient(address, timeout_s=PATIENCE_S, tls=tls) as client:
        with pytest.raises(ServerUnavailableError) as by_call:
            client.info()
        with pytest.raises(NotReadyError, match=f"no simulator serves at {address}") as by_check:
            client.check_ready(PATIENCE_S)
        with pytest.raises(DeadlineExceededError) as by_wait:
            client.wait_ready(0.5)
        assert not client.is_ready(PATIENCE_S)
    advice = str(by_call.value).partition(" (UNAVAILABLE")[0]
    for other in (by_check, by_wait):
        assert advice in str(other.value)
    return advice


def test_a_server_that_proves_nothing_says_what_is_wrong(
    served_with: ServedWith, authority: Authority, tmp_path: Path
) -> None:
    pair = authority.pair("server")
    encrypted = served_with(ServerTls(*pair))
    stranger = Authority(tmp_path, "stranger")
    assert "none of the authorities in tls_ca" in said_by(encrypted, ClientTls(stranger.ca))
    expired = served_with(ServerTls(*authority.pair("old", expired=True)))
    assert "has expired" in said_by(expired, ClientTls(authority.ca))
    with port(ServerTls(*pair), "127.0.0.2") as elsewhere:
        assert "other names" in said_by(elsewhere, ClientTls(authority.ca))


def test_one_side_that_does_not_encrypt_is_told_so(
    served_with: ServedWith, authority: Authority
) -> None:
    plain, encrypted = served_with(None), served_with(ServerTls(*authority.pair("server")))
    assert "leave tls_ca" in said_by(plain, ClientTls(authority.ca))
    assert "--tls-ca" in said_by(encrypted, None)


def test_a_client_that_proves_nothing_is_told_what_it_lacks(
    served_with: ServedWith, authority: Authority, tmp_path: Path
) -> None:
    server = served_with(ServerTls(*authority.pair("server"), authority.ca))
    stranger = Authority(tmp_path, "stranger")
    for tls in (
        ClientTls(authority.ca),
        ClientTls(authority.ca, *stranger.pair("other")),
        ClientTls(authority.ca, *authority.pair("old", expired=True)),
    ):
        assert "tls_cert and tls_key with a valid certificate" in said_by(server, tls)


def test_a_command_says_it_too(
    served_with: ServedWith, authority: Authority, tmp_path: Path
) -> None:
    server = served_with(ServerTls(*authority.pair("server"), authority.ca))
    done = oaisys("heights", "--out", tmp_path / "h.npz", "--address", server)
    assert done.returncode == 1
    assert "--tls-ca" in done.stderr
    assert "Traceback" not in done.stderr
    assert "ssl_transport_security" not in done.stderr
