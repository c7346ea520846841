"""The function with which Cycles ends a render while it takes samples.

Blender's own way to stop a render waits for the samples that Cycles has begun, and in background
mode Cycles begins as many at once as take 30 s. Cycles itself stops between two samples of a pixel.

Private part: ``ccl::Session::cancel``, called at the address that the library's table of symbols
    gives, with the session that a ``ccl::BlenderSession`` points to at a known offset.
Tried with: bpy 4.5.15 and 5.2.3.
Public way without it: the render goes on, and the server kills its worker, as it does with any
    that does not answer (`oaisys_grpc.server.supervision.worker_process`).
Lost without it: 8 to 11 s for a new worker that builds the world again, instead of 0.1 s.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import CFUNCTYPE, c_bool, c_void_p
from functools import cache
from threading import Thread

from oaisys_core.private.blender_symbols import symbol_address
from oaisys_core.system.fallbacks import report_fallback

KNOWN_VERSIONS = {(4, 5), (5, 2)}
"""Versions of Blender in which `SESSION_OFFSET` and the function's arguments are known."""

CANCEL_SYMBOL = b"_ZN3ccl7Session6cancelEb"
"""``ccl::Session::cancel(bool quick)``; any thread may call it while the session lives."""

SESSION_OFFSET = 8
"""Bytes from the start of a ``ccl::BlenderSession`` to its pointer to the ``ccl::Session``."""

LOST_S = 1.0
"""Time after which a call that has not returned is taken to be lost; it takes milliseconds."""


def end_sampling(session: int, version: tuple[int, ...]) -> None:
    """Make the render that runs in a session end at once, and wait for that; on any thread.

    Between two rounds of samples, Cycles forgets the call, begins the next round, of up to 30 s,
    and lets the call wait for its end. A second call, on another thread, then ends that round.

    Nothing happens with a version of Blender where the way is not known. Call it only after Cycles
    has copied the scene: it cannot go on with one that was copied in part.

    Args:
        session: Of a render that is running, see `cycles_addon.session_of`.
        version: ``bpy.app.version``.
    """
    cancel = _cancel_function(version[:2])
    if cancel is None or not session:
        return
    arguments = (c_void_p.from_address(session + SESSION_OFFSET), True)
    first, second = (Thread(target=cancel, args=arguments, name="end_sampling") for _ in range(2))
    first.start()
    first.join(LOST_S)
    if first.is_alive():
        second.start()
        second.join()
    first.join()


@cache
def _cancel_function(version: tuple[int, ...]) -> Callable[[c_void_p, bool], None] | None:
    """Return ``ccl::Session::cancel``; None where it is not known."""
    address = symbol_address(CANCEL_SYMBOL) if version in KNOWN_VERSIONS else None
    if address is None:
        reason = f"Blender {'.'.join(map(str, version))}"
        instead = "a render that is no longer wanted goes on until its worker is killed"
        report_fallback("Cycles' function that ends a render", reason, instead)
        return None
    return CFUNCTYPE(None, c_void_p, c_bool)(address)
