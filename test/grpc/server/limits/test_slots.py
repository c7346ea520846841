"""Slots for the calls of a method: their order, and which calls make room for others."""

from __future__ import annotations

import threading
import time

import pytest
from waiting import wait_until

from oaisys_core.errors import QueueFullError
from oaisys_grpc.server.limits import slots as slots_module
from oaisys_grpc.server.limits.open_calls import CROWDED_PATIENCE_S, OpenCall, OpenCalls, Phase
from oaisys_grpc.server.limits.slots import Slots

CALLS = OpenCalls()


class Context:
    def __init__(self, peer: str) -> None:
        self._peer = peer

    def peer(self) -> str:
        return self._peer

    def invocation_metadata(self) -> tuple[()]:
        return ()

    def cancel(self) -> None:
        """Nothing is under way."""


def call_of(peer: str) -> OpenCall:
    call = OpenCall(Context(peer), "GetSample", CALLS)
    call.enter(Phase.WORK)
    return call


def taken_slots(*, idle_make_room: bool = False) -> tuple[Slots, OpenCall, OpenCall]:
    """Return two slots, and the calls of two connections that have them, in their order."""
    slots = Slots(2, idle_make_room=idle_make_room)
    first, second = call_of("a"), call_of("b")
    slots.take(first)
    slots.take(second)
    return slots, first, second


def until_it_lags(call: OpenCall) -> None:
    for _ in range(10):
        call.look()
    assert call.lags()


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
    slots, old, young = taken_slots(idle_make_room=True)
    old.enter(Phase.WORK)
    until_it_lags(old)
    until_it_lags(young)
    slots.take(call_of("c"))
    assert (old.ended, young.ended) == (True, False)


def test_a_call_that_is_not_read_makes_room_once_its_process_had_the_time_to_see_a_reader(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(slots_module, "SLOT_PATIENCE_S", 0.1)
    slots, working, unread = taken_slots()
    unread.enter(Phase.READER)
    time.sleep(1.5 * CROWDED_PATIENCE_S)  # a starved process: nobody looks
    with pytest.raises(QueueFullError):
        slots.take(call_of("c"))
    assert not unread.ended
    until_it_lags(unread)
    slots.take(call_of("c"))
    assert (working.ended, unread.ended) == (False, True)


def test_a_call_whose_messages_are_read_does_not_make_room(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(slots_module, "SLOT_PATIENCE_S", 0.1)
    slots, _, read = taken_slots()
    for _ in range(10):
        read.enter(Phase.READER)
        read.look()
        read.look()
    assert not read.lags()
    with pytest.raises(QueueFullError):
        slots.take(call_of("c"))
    assert not read.ended
