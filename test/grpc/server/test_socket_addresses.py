"""Addresses of Unix sockets that the kernel would not take."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path

import grpc
import pytest
from waiting import PATIENCE_S

from oaisys_core.errors import InvalidInputError
from oaisys_core.system.socket_paths import MAX_PATH_BYTES
from oaisys_grpc.addresses import check_address, grpc_target, unix_path


def test_an_address_that_is_too_long_is_refused() -> None:
    for letters, is_taken in ((MAX_PATH_BYTES, True), (MAX_PATH_BYTES + 1, False)):
        address = "unix:/" + "s" * (letters - 1)
        expected = (
            nullcontext() if is_taken else pytest.raises(InvalidInputError, match="107 bytes")
        )
        with expected:
            check_address(address, insecure=False, encrypted=False)


@pytest.mark.parametrize("name", ["a b", "100%41", "is it?", "no#1", "\u00fc"])
def test_a_socket_is_where_its_address_says(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With ?, the server said that it was ready, and listened where nobody looked."""
    (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    for number, folder in enumerate((name, f"~/{name}")):
        address = f"unix:{folder}/{number}"
        server = grpc.server(ThreadPoolExecutor(1))
        server.add_insecure_port(grpc_target(address))
        server.start()
        try:
            assert (tmp_path / name / str(number)).is_socket()
            assert unix_path(address).is_socket()
            with grpc.insecure_channel(grpc_target(address)) as channel:
                grpc.channel_ready_future(channel).result(PATIENCE_S)
        finally:
            server.stop(None).wait()
