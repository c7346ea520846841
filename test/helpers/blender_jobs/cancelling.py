"""What the tests of cancelled renders do inside Blender."""

from __future__ import annotations

from ctypes import addressof, c_void_p, create_string_buffer, sizeof
from threading import Event, Thread

# Comes before anything that loads Open3D.
import bpy

from oaisys_core.private import cycles_session


def calls_to_end(lost: int, patience_s: float) -> list[int | None] | None:
    """Return the sessions that are told to end if Cycles forgets the first calls.

    Such a call waits until another one has ended the render. None: it did not end.
    """
    session = create_string_buffer(2 * sizeof(c_void_p))
    c_void_p.from_address(addressof(session) + cycles_session.SESSION_OFFSET).value = 4711
    has_ended, told = Event(), []

    def cancel(of_session: c_void_p, is_quick: bool) -> None:
        told.append(of_session.value)
        if len(told) > lost:
            has_ended.set()
        has_ended.wait()

    setattr(cycles_session, "_cancel_function", lambda _: cancel)  # noqa: B010
    arguments = addressof(session), bpy.app.version
    call = Thread(target=cycles_session.end_sampling, args=arguments, daemon=True)
    call.start()
    call.join(patience_s)
    return None if call.is_alive() else told
