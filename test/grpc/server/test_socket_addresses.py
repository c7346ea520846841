"""Addresses of Unix sockets that the kernel would not take."""

from __future__ import annotations

from contextlib import nullcontext

import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_core.system.socket_paths import MAX_PATH_BYTES
from oaisys_grpc.addresses import check_address


def test_an_address_that_is_too_long_is_refused() -> None:
    for letters, is_taken in ((MAX_PATH_BYTES, True), (MAX_PATH_BYTES + 1, False)):
        address = "unix:/" + "s" * (letters - 1)
        expected = (
            nullcontext() if is_taken else pytest.raises(InvalidInputError, match="107 bytes")
        )
        with expected:
            check_address(address, insecure=False, encrypted=False)
