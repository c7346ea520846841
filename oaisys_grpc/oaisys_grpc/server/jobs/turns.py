"""Whose turn it is: connections take turns, and those that leave answers unread share one turn."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Collection
from enum import IntEnum

MAX_CONNECTIONS = 1024
"""Connections that are remembered; the least recent ones are forgotten."""


class Standing(IntEnum):
    """What is known of a connection, the best last."""

    UNREAD = 0
    NEW = 1
    KNOWN = 2


class Turns:
    """Chooses whose job is next; safe for any thread.

    A connection that has read an answer to its end has a turn of its own. All new ones share one,
    and so do all that left an answer unread: however many there are, others wait for one of them.
    Within a shared turn connections take turns, too.
    """

    def __init__(self) -> None:
        self._standing: OrderedDict[str, Standing] = OrderedDict()
        self._served: dict[str, int] = {}
        self._count = 0
        self._lock = threading.Lock()

    def standing(self, peer: str) -> Standing:
        """Return what is known of a connection."""
        return self._standing.get(peer, Standing.NEW)

    def note_read(self, peer: str) -> None:
        """Note that a connection has read an answer to its end."""
        self._note(peer, Standing.KNOWN)

    def note_unread(self, peer: str) -> None:
        """Note that an answer was ended because its connection did not read it."""
        self._note(peer, Standing.UNREAD)

    def next(self, peers: Collection[str], others: Collection[str] = ()) -> str:
        """Return which of some connections is next, the first ones first, and count its turn.

        Args:
            peers: Those that may be next.
            others: Those that wait, too: their turns are not forgotten.
        """
        with self._lock:
            turns = {p: [self._served.get(name, 0) for name in self._names(p)] for p in peers}
            chosen = min(turns, key=turns.__getitem__)
            self._count += 1
            waiting = {name for peer in (*peers, *others) for name in self._names(peer)}
            self._served = {name: self._served.get(name, 0) for name in waiting}
            self._served.update(dict.fromkeys(self._names(chosen), self._count))
        return chosen

    def _names(self, peer: str) -> tuple[str, str]:
        """Return who shares a turn with a connection, and the connection."""
        standing = self.standing(peer)
        return (peer if standing is Standing.KNOWN else standing.name), peer

    def _note(self, peer: str, standing: Standing) -> None:
        with self._lock:
            self._standing[peer] = standing
            self._standing.move_to_end(peer)
            while len(self._standing) > MAX_CONNECTIONS:
                self._standing.popitem(last=False)
