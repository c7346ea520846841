"""The way in which viser starts the server of its page.

Private part: viser calls ``websockets.asyncio.server.serve`` with a ``process_request``, which is
    asked about each request; both are wrapped while viser starts. Messages are bounded, and those
    that the page does not use are dropped as they are received (``create_connection``, public).
Tried with: viser 1.1.1, websockets 16.1.1.
Public way without it: none; viser offers no check of requests. The page is not served at all.
Lost without it: the live page; reports, their meshes, RViz and Foxglove show the same.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any

from websockets.asyncio import server
from websockets.http11 import Request, Response

from oaisys_core.errors import OaisysError

Answer = Response | None
Process = Callable[[Any, Request], Answer | Awaitable[Answer]]
"""What `websockets` asks about each request: a response, or None for a WebSocket."""

SERVE = "serve"
"""Name of the function that viser starts its server with."""

MAX_MESSAGE_BYTES = 4_000_000
"""Of a browser; viser's bound of 50 MB is for pictures of its window, which nobody asks for here.

A message of 49 MB took 0.5 GB, and held up all other browsers for seconds.
"""

MAX_RATE_HZ = 100.0
"""Messages of a browser that are read in a second; the others wait in its own network buffers.

A browser sends at most one of its camera in 20 ms, and one of a slider in 50 ms.
"""

BURST = 200
"""Messages that are read at once from a browser that was silent before."""


@contextmanager
def requests_asked_about(
    wrap: Callable[[Process], Process], is_used: Callable[[bytes | str], bool]
) -> Iterator[None]:
    """Have a viser server that is started in the block ask about requests and messages.

    Args:
        wrap: Given what asks about requests, returns what asks in its place.
        is_used: Whether a message of a browser is handed to viser; otherwise it is dropped.

    Raises:
        OaisysError: viser has not started its server in this way.
    """
    plain, wrapped = getattr(server, SERVE, None), []

    def serve(*arguments: Any, process_request: Process, **options: Any) -> Any:
        assert plain is not None
        wrapped.append(True)
        options["max_size"] = MAX_MESSAGE_BYTES
        options["create_connection"] = _connection_that_drops(is_used)
        return plain(*arguments, process_request=wrap(process_request), **options)

    if plain is not None:
        setattr(server, SERVE, serve)
    try:
        yield
    finally:
        if plain is not None:
            setattr(server, SERVE, plain)
    if not wrapped:
        raise OaisysError("viser has started its server in another way: the page has no guard")


def _connection_that_drops(
    is_used: Callable[[bytes | str], bool],
) -> type[server.ServerConnection]:
    """Return a connection that receives only messages that are used, and not too many at once."""

    class CheckedConnection(server.ServerConnection):
        _next_s = 0.0

        async def recv(self, decode: bool | None = None) -> Any:
            while True:
                data = await super().recv(decode)
                await self._keep_pace()
                if is_used(data):
                    return data

        async def _keep_pace(self) -> None:
            now_s = time.monotonic()
            self._next_s = max(self._next_s, now_s - BURST / MAX_RATE_HZ) + 1 / MAX_RATE_HZ
            await asyncio.sleep(max(self._next_s - now_s, 0.0))

    return CheckedConnection
