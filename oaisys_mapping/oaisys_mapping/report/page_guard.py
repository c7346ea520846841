"""Lets only those to a live page who know its address, and whose browser is on that page itself.

A page of somebody else can open WebSockets to this machine, and a name that its owner points to
127.0.0.1 makes the browser take both for one site. So each request must have a random token in its
path, a Host that is no foreign name, and, from a page, the Origin of this one.
"""

from __future__ import annotations

import hmac
import http
import inspect
import ipaddress
import logging
import secrets
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any
from urllib.parse import urlsplit

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from oaisys_core.system.periodic_count import PeriodicCount
from oaisys_mapping.private.viser_server import Answer, Process, requests_asked_about

_LOG = logging.getLogger(__name__)

GONE_S = 30.0
"""A browser that takes nothing of what it is sent for so long is gone, or as good as."""


class PageGuard:
    """Checks each request to a page.

    Args:
        host: The address on which the page listens; requests may name it.
        now_s: A clock.

    Attributes:
        token: The first part of the paths of all requests.
        refused: How many requests were refused.
    """

    def __init__(self, host: str, now_s: Callable[[], float] = time.monotonic) -> None:
        self.token = secrets.token_urlsafe(24)
        self.refused = 0
        self._names = {"localhost", host.lower(), socket.gethostname().lower()}
        self._untold = PeriodicCount(now_s)

    @contextmanager
    def install(self, is_used: Callable[[bytes | str], bool]) -> Iterator[None]:
        """Have the server that is started in the block ask this guard about every request.

        Args:
            is_used: Whether a message of a browser is handed to the server.

        Raises:
            OaisysError: The server does not ask: the page would be without a guard.
        """
        with requests_asked_about(self._wrap, is_used):
            yield

    def fault(self, request: Request) -> str:
        """Return what is wrong with a request; nothing: it may be answered."""
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        if len(hosts) != 1 or not self._is_own(_name_of(f"//{hosts[0]}")):
            return f"Host is {', '.join(hosts)[:80]!r}, which is not this page's"
        own = {f"{scheme}://{hosts[0].lower()}" for scheme in ("http", "https")}
        if not own.issuperset(origin.lower() for origin in origins):
            return f"Origin is {', '.join(origins)[:80]!r}, which is not this page"
        given = request.path.split("?")[0].split("/")[1:2]
        if not hmac.compare_digest("".join(given).encode(), self.token.encode()):
            return "the token in the address is missing or wrong"
        return ""

    def tell(self, *, at_once: bool = False) -> None:
        """Write how many requests were refused since the last line, if that is due."""
        count, reason = self._untold.take(at_once=at_once)
        if count:
            _LOG.warning("requests to the page refused: %d, the last because %s", count, reason)

    def _is_own(self, name: str | None) -> bool:
        """Return whether a host is an address or a name of this machine; no other name is."""
        try:
            return bool(ipaddress.ip_address(name or ""))
        except ValueError:
            return name in self._names

    def _wrap(self, process: Process) -> Process:
        async def guard(connection: Any, request: Request) -> Answer:
            if reason := self.fault(request):
                self.refused += 1
                self._untold.add(reason)
                self.tell()
                return _response(http.HTTPStatus.FORBIDDEN, f"refused: {reason}\n")
            _end_when_gone(connection)
            path = request.path.removeprefix(f"/{self.token}")
            if not path.startswith("/") and "Upgrade" not in request.headers:
                return _response(http.HTTPStatus.FOUND, "", Location=f"/{self.token}/{path}")
            answer = process(connection, replace(request, path=path))
            answer = await answer if inspect.isawaitable(answer) else answer
            if answer is not None:
                answer.headers["Referrer-Policy"] = "no-referrer"  # the token stays here
            return answer

        return guard


def _end_when_gone(connection: Any) -> None:
    """Have the kernel end a connection whose other end takes nothing more.

    A page's own pings wait behind what was sent before, and so for ever.
    """
    end = connection.transport.get_extra_info("socket")
    if hasattr(socket, "TCP_USER_TIMEOUT"):
        end.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(1000 * GONE_S))


def _name_of(address: str) -> str | None:
    """Return the host of an address in lower case, without its port; None: it has none."""
    try:
        return urlsplit(address).hostname
    except ValueError:
        return None


def _response(status: http.HTTPStatus, text: str, **headers: str) -> Response:
    body = text.encode()
    kept = Headers({"Content-Type": "text/plain; charset=utf-8", **headers})
    kept["Content-Length"] = str(len(body))
    return Response(status, status.phrase, kept, body)
