"""Slots for the calls of a method are given in the order of the calls."""

from __future__ import annotations

import threading

import pytest
from waiting import wait_until

from oaisys_core.errors import QueueFullError
from oaisys_grpc.server.limits.open_calls import OpenCall, Phase, Slots


class Context:
    def __init__(self, peer: str) -> None:
        self._peer = peer

    def peer(self) -> str:
        return self._peer

    def cancel(self) -> None:
        """Nothing is under way."""


def call_of(peer: str) -> OpenCall:
    call = OpenCall(Context(peer), "GetSample")
    call.enter(Phase.WORK)
    return call


def test_calls_that_wait_are_served_in_their_order() -> None:
    slots = Slots(2)
    running = [call_of("a"), call_of("b")]
    for call in running:
        slots.take(call)
    served: list[int] = []
    waiting = [call_of(f"client {index}") for index in range(6)]

    def take(index: int) -> None:
        slots.take(waiting[index])
        served.append(index)
        slots.release(waiting[index])

    threads = []
    for index, call in enumerate(waiting):
        threads.append(threading.Thread(target=take, args=(index,)))
        threads[-1].start()
        wait_until(lambda call=call: call in slots._waiting)  # type: ignore[misc]
    slots.release(running[0])
    for thread in threads:
        thread.join(60)
    assert served == sorted(served)
    assert len(served) == 6


def test_a_connection_with_its_share_does_not_hold_up_others() -> None:
    slots = Slots(4)
    for _ in range(3):
        slots.take(call_of("greedy"))
    with pytest.raises(QueueFullError, match="GetSample"):
        slots.take(call_of("greedy"))
    slots.take(call_of("other"))


def test_the_oldest_idle_call_makes_room() -> None:
    slots = Slots(2, idle_make_room=True)
    old, young = call_of("a"), call_of("b")
    slots.take(old)
    slots.take(young)
    old.enter(Phase.WORK)
    slots.take(call_of("c"))
    assert (old.ended, young.ended) == (True, False)
