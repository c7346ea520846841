"""Against whom a lost worker counts: a request, its client, or the worker itself."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable
from typing import NamedTuple, TypeVar

from oaisys_core.errors import OaisysError, WorkerLostError
from oaisys_grpc.contract.faults import DeadlyRequestError
from oaisys_grpc.server.supervision.worker_limits import CRASH_WINDOW_S, LONGEST_PAUSE_S, Breaker

DEATHS_ALLOWED = 2
"""After so many lost workers a request is refused: one may be lost by chance."""

CLIENTS_ALLOWED = 2
"""More clients than these that lose workers, and none that renders, mean a faulty worker."""

_MAX_REQUESTS, _MAX_CLIENTS = 1024, 1024
"""That are remembered; the least recent ones are forgotten."""

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")

_NEWCOMERS = "connections without a success"


class OutgrownWorkerError(WorkerLostError):
    """The call took more memory than there is; it would do so again."""


class KilledWorkerError(WorkerLostError):
    """Somebody else killed the worker, which may have nothing to do with the call."""


class Cause(NamedTuple):
    """What a worker was doing.

    Attributes:
        client: The connection that asked.
        digest: Of method, world and request; equal for requests that do the same.
    """

    client: str
    digest: bytes


class _Death(NamedTuple):
    number: int
    since_s: float
    error: OaisysError


class Crashes:
    """Remembers which requests and clients lost workers; one thread calls it."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._requests: OrderedDict[bytes, _Death] = OrderedDict()
        self._clients: OrderedDict[str, Breaker] = OrderedDict()
        self._known: OrderedDict[str, None] = OrderedDict()
        self._in_vain: dict[str, float] = {}

    def refusal(self, cause: Cause) -> OaisysError | None:
        """Return why a request is not to be tried, if so."""
        death = self._requests.get(cause.digest)
        if (
            death is not None
            and death.number >= DEATHS_ALLOWED
            and self._now_s() < death.since_s + LONGEST_PAUSE_S
        ):
            return DeadlyRequestError(f"refused, because it ends the worker: {death.error}")
        breaker = self._clients.get(cause.client)
        return None if breaker is None else breaker.refusal

    def note_success(self, cause: Cause, *, rendered: bool) -> None:
        """Note that a client's request succeeded; only a render shows that the worker is well."""
        self._requests.pop(cause.digest, None)
        if rendered:
            self._in_vain.clear()
        _keep(self._known, cause.client, None, _MAX_CLIENTS)

    def note_crash(self, cause: Cause, error: OaisysError) -> bool:
        """Note that a worker was lost; return whether it is the worker that is at fault."""
        if isinstance(error, WorkerLostError) and not isinstance(error, KilledWorkerError):
            before = self._requests.get(cause.digest)
            count = 1 if before is None else before.number + 1
            if isinstance(error, OutgrownWorkerError):
                count = max(count, DEATHS_ALLOWED)
            death = _Death(count, self._now_s(), error)
            _keep(self._requests, cause.digest, death, _MAX_REQUESTS)
        breaker = self._clients.get(cause.client) or Breaker(
            self._now_s, state="requests of this connection are refused", end="one is tried again"
        )
        breaker.note_crash(error)
        _keep(self._clients, cause.client, breaker, _MAX_CLIENTS)
        return self._is_everybodys(cause.client)

    def _is_everybodys(self, client: str) -> bool:
        """Return whether too many clients failed lately, and none succeeded.

        Connections cost nothing. Those that never had a success count as one client, unless nobody
        ever had one.
        """
        now_s = self._now_s()
        name = client if client in self._known or not self._known else _NEWCOMERS
        self._in_vain[name] = now_s
        self._in_vain = {n: s for n, s in self._in_vain.items() if now_s < s + CRASH_WINDOW_S}
        return len(self._in_vain) > CLIENTS_ALLOWED


def _keep(kept: OrderedDict[_Key, _Value], key: _Key, value: _Value, most: int) -> None:
    """Put an item last, and forget the first ones if there are too many."""
    kept[key] = value
    kept.move_to_end(key)
    while len(kept) > most:
        kept.popitem(last=False)
