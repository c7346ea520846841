"""Answers of a service that are sent later than its callback returns, and on another thread.

Private part: rclpy's executor sends what a callback returns with ``send_response`` of the instance
    of ``Service``, with the header of its request.
Tried with: rclpy 7.1.6.
Public way without it: the callback does the work, and requests wait in the middleware's queue.
Lost without it: the refusal of requests beyond the limit; the middleware drops the oldest of those
    beyond its depth without an answer.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from oaisys_core.system.fallbacks import report_fallback

SEND = "send_response"
"""Method of a service."""


def send_later(service: Any, take: Callable[[Any, Callable[[Any], object]], object]) -> bool:
    """Have ``take`` called with each answer that a service's callback returns, instead of sending.

    Args:
        service: Of rclpy.
        take: Its second argument sends an answer, once, on any thread.

    Returns:
        Whether rclpy allows it; if not, answers are sent as callbacks return them.
    """
    send = getattr(service, SEND, None)
    if send is None:
        instead = "requests wait in the middleware's queue"
        report_fallback("rclpy's services", f"a service has no {SEND}", instead)
        return False
    setattr(service, SEND, lambda response, header: take(response, partial(send, header=header)))
    return True
