"""Services whose requests wait in a queue of ours: each is answered, or refused in words.

rclpy leaves requests that wait in the middleware's queue. That has ten places by default, and drops
the oldest request when another one comes, without an answer.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from oaisys_ros_bridge.private.later_answers import send_later
from oaisys_ros_bridge.qos import MAX_WAITING, SERVICE_QOS

Callback = Callable[[Any, Any], Any]
"""Answers a request: fills the response, its second argument, in, and returns it."""
Refusal = Callable[[Any, str], object]
"""Writes into a response why its request is refused."""

TOO_MANY = (
    f"too many requests: {MAX_WAITING} wait for this service already; wait for answers, try again"
)
REFUSAL_PAUSE_S = 0.01
"""Before each refusal: by default, the queue of a client's answers has ten places, too."""
THREAD_SUFFIX = " requests"
"""Of the names of threads that serve requests."""
END_S = 3.0
"""How long requests that are being served may take to end with their node."""


def write_message(response: Any, reason: str) -> None:
    """Refuse a request by the field ``message``; ``success`` stays false."""
    response.message = reason


class RequestQueue:
    """Serves the requests of one service, or of several, one at a time and in their order.

    Requests are taken from the middleware as they come, and served on a thread of their own. Beside
    the one that is served, `MAX_WAITING` may wait; further ones are refused at once.

    Args:
        node: Offers the services.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock = threading.Lock()
        self._works: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        self._open = 0
        self._ended = ""
        self._thread: threading.Thread | None = None
        self._error: Exception | None = None
        self._failed = node.create_guard_condition(
            self._raise_error, callback_group=MutuallyExclusiveCallbackGroup()
        )

    @property
    def is_busy(self) -> bool:
        """Whether a request is being served, or waits."""
        return self._open > 0

    def offer(
        self, kind: Any, name: str, callback: Callback, refuse: Refusal = write_message
    ) -> None:
        """Offer a service.

        Args:
            kind: Its type.
            name: Its name.
            callback: Answers a request, on this queue's thread.
            refuse: Writes into a response why there are too many.
        """
        taken: list[Any] = []  # the request whose response `take` is given next

        def note(request: Any, response: Any) -> Any:
            taken.append(request)
            return response

        def take(response: Any, send: Callable[[Any], object]) -> None:
            request = taken.pop()

            def answer() -> None:
                answered = response
                try:
                    if self._ended:
                        refuse(response, self._ended)
                    else:
                        answered = callback(request, response)
                except Exception as error:  # noqa: BLE001 - one request must not end the others
                    answered = kind.Response()
                    refuse(answered, self._fault(name, error))
                send(answered)

            if reason := self.submit(answer):
                refuse(response, reason)
                time.sleep(REFUSAL_PAUSE_S)
                send(response)

        group = MutuallyExclusiveCallbackGroup()
        service = self._node.create_service(
            kind, name, note, qos_profile=SERVICE_QOS, callback_group=group
        )
        if not send_later(service, take):
            service.callback = callback

    def _fault(self, service: str, error: Exception) -> str:
        """Log an error that nobody expected, and return what its caller is told."""
        fault = f"{type(error).__name__}: {error}"
        self._node.get_logger().error(f"{service}: {fault}\n{traceback.format_exc()}")
        return f"a fault of {self._node.get_name()}, see its log: {fault}"

    def submit(self, work: Callable[[], object]) -> str:
        """Do work in turn with the requests; return why not, or nothing."""
        with self._lock:
            if self._ended:
                return self._ended
            if self._open > MAX_WAITING:
                return TOO_MANY
            self._open += 1
            self._works.put(work)
            if self._thread is None:
                name = f"{self._node.get_name()}{THREAD_SUFFIX}"
                self._thread = threading.Thread(target=self._serve, name=name, daemon=True)
                self._thread.start()
        return ""

    def end(self) -> None:
        """Refuse all further requests, and those that wait."""
        with self._lock:
            self._ended = f"{self._node.get_name()} ends"
            self._works.put(None)

    def join(self, end_s: float) -> None:
        """Wait, after `end`, until all are answered, or until a time of the steady clock."""
        if self._thread is not None:
            self._thread.join(max(end_s - time.monotonic(), 0.0))

    def _serve(self) -> None:
        while (work := self._works.get()) is not None:
            try:
                work()
            except Exception as error:  # noqa: BLE001 - ends the node, as that of a callback does
                if not self._ended:
                    self._error = error
                    self._failed.trigger()
            finally:
                with self._lock:
                    self._open -= 1

    def _raise_error(self) -> None:
        if self._error is not None:
            raise self._error


class NodeServices:
    """The services of a node, each with a queue of its own.

    Args:
        node: Offers them.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._queues: list[RequestQueue] = []

    def offer(
        self, kind: Any, name: str, callback: Callback, refuse: Refusal = write_message
    ) -> None:
        """Offer a service; see `RequestQueue.offer`."""
        queue = RequestQueue(self._node)
        queue.offer(kind, name, callback, refuse)
        self._queues.append(queue)

    def close(self) -> None:
        """Refuse all requests that wait, and wait for the end of those that are being served."""
        close_queues(self._queues)


def close_queues(queues: Sequence[RequestQueue]) -> None:
    """Refuse the requests that wait in queues; wait up to `END_S` for those being served."""
    for queue in queues:
        queue.end()
    end_s = time.monotonic() + END_S
    for queue in queues:
        queue.join(end_s)


def is_any_request_served() -> bool:
    """Return whether requests are still being served in this process, such as after `END_S`."""
    return any(each.name.endswith(THREAD_SUFFIX) for each in threading.enumerate())
