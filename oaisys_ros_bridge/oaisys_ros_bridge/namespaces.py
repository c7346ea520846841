"""Keeps simulators apart that run at the same time: by ROS namespaces and by ROS domains.

Topics, services and actions of this package have relative names, so a namespace moves them all. The
names ``/tf`` and ``/tf_static`` are absolute: below a namespace they are remapped to
``NAMESPACE/tf`` and ``NAMESPACE/tf_static``. ``/clock`` and ``/diagnostics`` stay at the root.
"""

from __future__ import annotations

import contextlib
import errno
import os
import random
import re
import socket
from collections.abc import Iterator

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_ros_bridge.shared_memory import foreign_ports

TF = "/tf"
TF_STATIC = "/tf_static"
CLOCK = "/clock"
DIAGNOSTICS = "/diagnostics"
OUTSIDE = (TF, TF_STATIC, CLOCK, DIAGNOSTICS)
"""Absolute names, which no namespace moves unless they are remapped."""

UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""The middleware's name of a node of which so far only a publisher or subscription is known."""

DOMAIN_VARIABLE = "ROS_DOMAIN_ID"
LARGEST_DOMAIN = 101
"""The ports of larger domains overlap the range from which Linux takes clients' ports."""

_CLAIM = "\0oaisys-ros-domain-{}"
"""An abstract socket's name: no file, so nothing that another user could plant; known to all users
of the same network, as are the ports of ROS."""

_NAMESPACE = re.compile(r"/?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")


def require_namespace(namespace: str) -> None:
    """Raise `InvalidInputError` where ROS would not take this namespace; empty is the root."""
    if namespace and not _NAMESPACE.fullmatch(namespace):
        raise InvalidInputError("namespace", namespace, "names like mars or lab/mars")


def namespace_arguments(namespace: str, *, has_own_tf: bool = True) -> list[str]:
    """Return the ROS arguments that put a node into a namespace; none for the root.

    Args:
        namespace: Its name.
        has_own_tf: Whether TF is in it, too.
    """
    if not namespace:
        return []
    rules = [f"__ns:=/{namespace.strip('/')}"]
    if has_own_tf:
        rules += [f"{topic}:={topic.removeprefix('/')}" for topic in (TF, TF_STATIC)]
    return ["--ros-args", *(argument for rule in rules for argument in ("-r", rule))]


def current_domain() -> int:
    """Return the number of this process's ROS domain; 0 where it is not set, or is no number."""
    number = os.environ.get(DOMAIN_VARIABLE, "")
    return int(number) if number.isascii() and number.isdigit() else 0


@contextlib.contextmanager
def claim_domain() -> Iterator[int]:
    """Claim a ROS domain for as long as the block lasts, and yield its number.

    The claim is the name of a socket, which the kernel takes back when the process ends. Processes
    of all users see it, so two of them never get the same domain. One in which another user has
    files of Fast DDS is left to that user.

    Raises:
        OaisysError: Other processes have claimed all of them.
    """
    for number in random.SystemRandom().sample(range(1, LARGEST_DOMAIN + 1), LARGEST_DOMAIN):
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as claim:
            try:
                claim.bind(_CLAIM.format(number))
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise OaisysError(f"no ROS domain can be claimed: {error}") from error
                continue
            if foreign_ports(number):
                continue
            yield number
            return
    raise OaisysError(
        f"all ROS domains from 1 to {LARGEST_DOMAIN} are in use: set {DOMAIN_VARIABLE}"
    )


@contextlib.contextmanager
def own_domain() -> Iterator[None]:
    """Set ``ROS_DOMAIN_ID`` to a claimed domain within the block, unless it is set already.

    Raises:
        OaisysError: Other processes have claimed all domains.
    """
    if DOMAIN_VARIABLE in os.environ:
        yield
        return
    with claim_domain() as number:
        os.environ[DOMAIN_VARIABLE] = str(number)
        try:
            yield
        finally:
            del os.environ[DOMAIN_VARIABLE]
