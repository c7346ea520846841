"""Messages that wait in a subscription, taken without the executor.

Private part: ``take_message`` of the handle of an rclpy ``Subscription``.
Tried with: rclpy 7.1.6.
Public way without it: the executor takes them, one each time that it wakes up.
Lost without it: time at a recording's end, and messages that have not come by then; and a request
    to the mapper may not count samples that were announced just before it.
"""

from __future__ import annotations

from typing import Any

from oaisys_core.system.fallbacks import report_fallback

TAKE = "take_message"
"""Method of a subscription's handle."""


def take_waiting(subscription: Any) -> tuple[Any, dict[str, Any]] | None:
    """Return a message that waits, with what the middleware knows of it; None: none waits.

    Call it with the handle entered (``with subscription.handle``).
    """
    take = getattr(subscription.handle, TAKE, None)
    if take is None:
        reason = f"a subscription's handle has no {TAKE}"
        report_fallback("Messages that wait", reason, "they are taken later, one by one")
        return None
    taken: tuple[Any, dict[str, Any]] | None = take(subscription.msg_type, subscription.raw)
    return taken
