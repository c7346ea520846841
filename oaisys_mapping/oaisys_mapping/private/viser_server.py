"""The way in which viser starts the server of its page.

Private part: viser calls ``websockets.asyncio.server.serve`` with a ``process_request``, which is
    asked about each request; both are wrapped while viser starts, and messages are bounded.
Tried with: viser 1.1.1, websockets 16.1.1.
Public way without it: none; viser offers no check of requests. The page is not served at all.
Lost without it: the live page; reports, their meshes, RViz and Foxglove show the same.
"""

from __future__ import annotations

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


@contextmanager
def requests_asked_about(wrap: Callable[[Process], Process]) -> Iterator[None]:
    """Have a viser server that is started in the block ask a wrapped `Process` about requests.

    Raises:
        OaisysError: viser has not started its server in this way.
    """
    plain, wrapped = getattr(server, SERVE, None), []

    def serve(*arguments: Any, process_request: Process, **options: Any) -> Any:
        assert plain is not None
        wrapped.append(True)
        options["max_size"] = MAX_MESSAGE_BYTES
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
