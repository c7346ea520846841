"""Addresses that a server listens on."""

from __future__ import annotations

import contextlib
import ipaddress
import os
import socket
import stat
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_core.files.folders import user_path
from oaisys_core.files.numbers import whole_of
from oaisys_core.system.socket_paths import MAX_PATH_BYTES, fits

DEFAULT_ADDRESS = "127.0.0.1:50051"

UNIX = "unix:"
LARGEST_PORT = 65535

_OWNER_ONLY = 0o177
"""Umask of a socket that only its owner may connect to."""


def check_address(address: str, *, insecure: bool, encrypted: bool) -> None:
    """Check an address, and refuse one that other machines can reach unless that is allowed.

    Raises:
        InvalidInputError: The address is refused, or is no address.
    """
    if address.startswith(UNIX):
        if not unix_path(address).name:
            raise InvalidInputError("--address", address, "unix:PATH")
        if not fits(unix_path(address)):
            expected = f"unix:PATH, with a path of at most {MAX_PATH_BYTES} bytes"
            raise InvalidInputError("--address", address, expected)
        return
    host, port = host_and_port(address)
    number = whole_of(port)
    if number is None or number > LARGEST_PORT:
        raise InvalidInputError(
            "--address", address, f"HOST:PORT, with a port up to {LARGEST_PORT}, or unix:PATH"
        )
    if not (insecure or encrypted or _is_loopback(host)):
        expected = (
            "a loopback address or unix:PATH; anyone could connect: "
            "--tls-cert and --tls-key encrypt, --insecure allows it without"
        )
        raise InvalidInputError("--address", address, expected)


def is_this_machine(address: str) -> bool:
    """Return whether a server at an address can only be one on this machine."""
    return address.startswith(UNIX) or _is_loopback(host_and_port(address)[0])


def host_and_port(address: str) -> tuple[str, str]:
    """Return both parts of ``HOST:PORT``."""
    host, _, port = address.rpartition(":")
    return host, port


def unix_path(address: str) -> Path:
    """Return the path in ``unix:PATH`` or ``unix:///PATH``.

    Raises:
        InvalidInputError: It begins with ``~`` of a user who does not exist.
    """
    path = address.removeprefix(UNIX)
    if path.startswith("//"):
        return Path("/", path.lstrip("/"))
    return user_path(path, "--address")


def grpc_target(address: str) -> str:
    """Return an address as gRPC takes it: as a URI, in which %, ? and # have a meaning.

    >>> grpc_target("unix:/tmp/100%/server"), grpc_target("127.0.0.1:50051")
    ('unix:/tmp/100%25/server', '127.0.0.1:50051')
    """
    return UNIX + quote(str(unix_path(address))) if address.startswith(UNIX) else address


@contextlib.contextmanager
def private_socket(address: str) -> Iterator[None]:
    """Make a ``unix:`` socket that the block binds accessible to this user alone; else do nothing.

    A socket that a dead server left behind is removed first.

    Raises:
        OaisysError: A server listens there, or something else is there.
    """
    if not address.startswith(UNIX):
        yield
        return
    _make_way(unix_path(address), address)
    before = os.umask(_OWNER_ONLY)
    try:
        yield
    finally:
        os.umask(before)


def remove_socket(address: str) -> None:
    """Remove a server's own ``unix:`` socket after it was closed; else do nothing."""
    if address.startswith(UNIX):
        unix_path(address).unlink(missing_ok=True)


def _make_way(path: Path, address: str) -> None:
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return
    except OSError as error:
        raise OaisysError(f"cannot listen on {address}: {error}") from error
    if not stat.S_ISSOCK(mode):
        raise OaisysError(f"cannot listen on {address}: there is a file that is no socket")
    with socket.socket(socket.AF_UNIX) as other:
        try:
            other.connect(str(path))
        except ConnectionRefusedError:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise OaisysError(f"cannot listen on {address}: {error}") from error
        else:
            raise OaisysError(f"cannot listen on {address}: a server listens there already")


def _is_loopback(host: str) -> bool:
    """Return whether all addresses of a host are loopback addresses."""
    if not host:
        return False
    try:
        found = socket.getaddrinfo(host.strip("[]"), None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        return False
    numbers = [str(sockaddr[0]).partition("%")[0] for *_, sockaddr in found]
    return bool(numbers) and all(ipaddress.ip_address(number).is_loopback for number in numbers)
