"""Results that are no longer wanted: who notices, and how a library's own loop is stopped."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from oaisys_core.errors import CancelledError
from oaisys_core.system.ending.interruption import (
    interruptible,
    make_wanted_check,
    stop_if_unwanted,
    stop_when_unwanted,
)

PATIENCE_S = 30.0


def raising_after(unwanted: threading.Event) -> Callable[[], None]:
    def check() -> None:
        if unwanted.is_set():
            raise CancelledError("enough")

    return check


def test_another_thread_learns_whether_the_result_is_wanted() -> None:
    unwanted = threading.Event()
    with interruptible(raising_after(unwanted)):
        is_wanted = make_wanted_check()
    found = []
    for _ in range(2):
        thread = threading.Thread(target=lambda: found.append(is_wanted()))
        thread.start()
        thread.join(PATIENCE_S)
        unwanted.set()
    assert found == [True, False]


def test_a_block_that_calls_no_check_is_stopped_by_another_thread() -> None:
    unwanted, stopped = threading.Event(), threading.Event()
    callers = []

    def stop() -> None:
        callers.append(threading.current_thread())
        stopped.set()

    with interruptible(raising_after(unwanted)):
        with stop_when_unwanted(stop):
            unwanted.set()
            assert stopped.wait(PATIENCE_S)
        assert not callers[0].is_alive()
        assert callers[0] is not threading.current_thread()
        with pytest.raises(CancelledError, match="enough"):
            stop_if_unwanted()


def test_stop_is_called_again_until_the_block_ends() -> None:
    unwanted, often = threading.Event(), threading.Event()
    calls: list[None] = []

    def stop() -> None:
        calls.append(None)
        if len(calls) == 3:
            often.set()

    unwanted.set()
    with interruptible(raising_after(unwanted)), stop_when_unwanted(stop):
        assert often.wait(PATIENCE_S)


@pytest.mark.parametrize("has_check", [True, False])
def test_a_block_whose_result_is_wanted_is_left_alone(has_check: bool) -> None:
    looked = threading.Event()
    calls: list[None] = []

    if has_check:
        with interruptible(looked.set), stop_when_unwanted(lambda: calls.append(None)):
            assert looked.wait(PATIENCE_S)
    else:
        threads = threading.active_count()
        with stop_when_unwanted(lambda: calls.append(None)):
            assert threading.active_count() == threads
    assert not calls
