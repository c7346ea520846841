"""Signals that end an experiment in order."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from oaisys_core.system.ending.signals import RECEIVED, defer_signals
from oaisys_ros_bridge.experiments.interruption import (
    interrupt_on_signals,
    raise_if_interrupted,
)


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in numbers]
    interrupt_on_signals()
    yield
    interrupt_on_signals()  # forgets a signal
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
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
