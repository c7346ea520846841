"""The loop over packets of rays, for which Embree 4 has no call.

Private part: ``rtcIntersect8`` and ``rtcOccluded8`` by their addresses, called by `embree_loop.c`,
    which set-up compiles, without Python's lock.
Tried with: Embree 4.4.0 of bpy 4.5.15, Embree 4.4.1 of bpy 5.2.3.
Public way without it: a loop that is Python's and keeps the lock. The images are the same.
Lost without it: time; no other thread works while rays are cast at objects. A draft takes 1.35
    times as long among plants, depth 1.35 times.
"""

from __future__ import annotations

from collections import deque
from ctypes import CDLL, c_size_t, c_void_p, cast
from functools import cache
from importlib.util import find_spec
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.system.fallbacks import report_fallback

LIBRARY = "oaisys_core.private._embree_loop"
"""A shared library rather than a module of Python; set-up puts it beside this file."""


def cast_packets(
    function: Any, valid: int, scene: Any, packets: NDArray[np.float32], arguments: int | None
) -> None:
    """Call a function once for each packet.

    Args:
        function: Of C, by ctypes, called without releasing Python's lock.
        valid: Address of what says which rays of a packet count.
        scene: Embree's handle.
        packets: (P, ...) packets, one after the other in memory.
        arguments: Address of Embree's arguments of a call; None: its own.
    """
    start, size = packets.ctypes.data, packets.strides[0]
    loop = _compiled_loop()
    if loop is not None:
        loop(cast(function, c_void_p), valid, scene, start, size, len(packets), arguments)
        return
    addresses = range(start, start + packets.nbytes, size)
    # This loop runs without Python bytecode.
    deque(map(function, repeat(valid), repeat(scene), addresses, repeat(arguments)), maxlen=0)


@cache
def _compiled_loop() -> Any:
    """Return ``cast_packets`` of `embree_loop.c`; None where it was not compiled."""
    found = find_spec(LIBRARY)
    try:
        if found is None or found.origin is None:
            raise OSError(f"{LIBRARY} was not compiled")
        loop = CDLL(found.origin).cast_packets
    except (OSError, AttributeError) as error:
        instead = "rays at objects are cast by one thread at a time, which takes longer"
        report_fallback("The compiled loop over rays", str(error), instead)
        return None
    loop.restype = None
    loop.argtypes = [c_void_p] * 4 + [c_size_t] * 2 + [c_void_p]
    return loop
