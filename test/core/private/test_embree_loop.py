"""The compiled loop over packets calls what Python's own loop calls, and keeps no lock."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from ctypes import CDLL, CFUNCTYPE, addressof, c_long, c_void_p
from typing import Any

import numpy as np
import pytest

from oaisys_core.private import embree_loop
from oaisys_core.private.embree_loop import cast_packets
from oaisys_core.system import fallbacks

PACKETS = np.zeros((5, 3, 8), np.float32)
CALLBACK = CFUNCTYPE(None, *[c_void_p] * 4)


@pytest.fixture(autouse=True)
def other_loop() -> Iterator[None]:
    """Look for the compiled loop anew in each test, and afterwards."""
    for cached in (embree_loop._compiled_loop, fallbacks.report_fallback):
        cached.cache_clear()
    yield
    embree_loop._compiled_loop.cache_clear()


def calls_of(arguments: int | None) -> list[tuple[Any, ...]]:
    """Return what each call is given, packets as offsets in bytes."""
    calls: list[tuple[Any, ...]] = []
    start = PACKETS.ctypes.data

    @CALLBACK
    def remember(valid: int, scene: int, packet: int, given: int | None) -> None:
        calls.append((valid, scene, packet - start, given))

    cast_packets(remember, 64, c_void_p(128), PACKETS, arguments)
    return calls


@pytest.mark.parametrize("arguments", [None, 256])
def test_each_packet_is_cast_once(arguments: int | None) -> None:
    expected = [(64, 128, 96 * index, arguments) for index in range(5)]
    assert calls_of(arguments) == expected


def test_without_the_compiled_loop_python_calls_the_same(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    expected = calls_of(256)
    embree_loop._compiled_loop.cache_clear()
    monkeypatch.setattr(embree_loop, "LIBRARY", "oaisys_core.private._none")
    assert calls_of(256) == expected
    (record,) = caplog.records
    assert "_none was not compiled" in record.getMessage()
    assert "cast by one thread at a time" in record.getMessage()


def test_other_threads_go_on_meanwhile() -> None:
    # ``nanosleep(requested, remaining)`` ignores the two arguments behind these.
    requested, remaining = (c_long * 2)(0, 50_000_000), (c_long * 2)()
    nanosleep = CDLL(None).nanosleep
    begun, ended = threading.Event(), threading.Event()
    worked_meanwhile = []

    def work() -> None:
        begun.wait()
        while not ended.is_set():
            worked_meanwhile.append(True)
            ended.wait(0.005)

    worker = threading.Thread(target=work)
    worker.start()
    begun.set()
    before = len(worked_meanwhile)
    cast_packets(nanosleep, addressof(requested), c_void_p(addressof(remaining)), PACKETS, None)
    worked = len(worked_meanwhile) - before
    ended.set()
    worker.join()
    assert worked > 5
