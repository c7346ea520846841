"""Signals that end an experiment in order."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest

from oaisys_core.system.ending.signals import (
    RECEIVED,
    defer_signals,
    end_service_at_signals,
    has_dropped_interruption,
    interrupt_at_signals,
)
from oaisys_ros_bridge.experiments.interruption import (
    interrupt_on_signals,
    raise_if_interrupted,
)


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
    before = [signal.getsignal(number) for number in numbers]
    interrupt_on_signals()
    yield
    RECEIVED.clear()
    interrupt_on_signals()  # forgets a signal
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_a_dropped_interruption_is_raised_again(number: signal.Signals) -> None:
    raise_if_interrupted()
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(number)
    with pytest.raises(KeyboardInterrupt):
        raise_if_interrupted()


def test_a_signal_is_deferred_to_the_end_of_the_outermost_block() -> None:
    reached = []

    def blocks() -> None:
        with defer_signals():
            with defer_signals():
                signal.raise_signal(signal.SIGINT)
                reached.append("inner")
            reached.append("outer")

    with pytest.raises(KeyboardInterrupt):
        blocks()
    assert reached == ["inner", "outer"]
    with defer_signals():
        pass  # it is raised once


def test_a_second_signal_does_not_interrupt_what_the_first_one_ends() -> None:
    """It ended the command by the signal itself, with what it had started left behind."""
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGHUP)
    signal.raise_signal(signal.SIGINT)
    assert RECEIVED[-2:] == [signal.SIGHUP, signal.SIGINT]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_handlers_that_follow_look_at_what_was_dropped_before(number: signal.Signals) -> None:
    interrupt_at_signals()
    assert not has_dropped_interruption()
    with suppress(KeyboardInterrupt):  # as a library does
        signal.raise_signal(number)
    assert has_dropped_interruption()
    for follow in (interrupt_at_signals, interrupt_on_signals):
        with pytest.raises(KeyboardInterrupt):
            follow()
    with pytest.raises(KeyboardInterrupt):
        end_service_at_signals(lambda *_: None)
    assert not has_dropped_interruption()
    end_service_at_signals(signal.SIG_IGN)  # at the end of a program


@pytest.mark.parametrize("moment", range(1, 7))
def test_a_signal_while_handlers_are_exchanged_leaves_none_that_defers(
    moment: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The others deferred for ever: SIGTERM ended nothing any more."""
    calls, exchange = [0], signal.signal

    def exchange_and_raise(number: int, handler: Any) -> Any:
        before = exchange(number, handler)
        calls[0] += 1
        if calls[0] == moment:
            os.kill(os.getpid(), signal.SIGINT)
        return before

    monkeypatch.setattr(signal, "signal", exchange_and_raise)
    with pytest.raises(KeyboardInterrupt), defer_signals():
        pass
    monkeypatch.undo()
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        signal.raise_signal(number)  # within `ORDER_S` of the first one
        assert RECEIVED[-1] == number
