"""What the page asks for, until the session takes it; safe to use from any thread."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from oaisys_core.types import FloatArray, ModuleMetadata, ShortRepr

Action = Literal[
    "new_world",
    "choose_vehicle",
    "take_picture",
    "keep_pose",
    "export_config",
    "start_bag",
    "stop_bag",
]

MAX_REQUESTS = 100
"""Requests that wait; more are clicks of somebody who waits for the first."""


@dataclass(frozen=True)
class Request:
    """What a button asks for.

    Attributes:
        action: What to do.
        values: The fields beside the button, by name.
    """

    action: Action
    values: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, repr=False)
class BrowserView(ShortRepr):
    """How the camera of the driver's browser has moved, which the simulator's camera follows.

    Attributes:
        step_m: (3,) its steps in ``map`` since the view that was taken before.
        R_map_camera: (3, 3) orientation of its optical frame (z forward, x right, y down).
    """

    step_m: FloatArray
    R_map_camera: FloatArray


class Desk:
    """Keeps requests in order, and joins views and changes of the light to one of each."""

    def __init__(self) -> None:
        self._news = threading.Condition()
        self._requests: deque[Request] = deque()
        self._view: BrowserView | None = None
        self._change: ModuleMetadata | None = None

    def post(self, request: Request) -> bool:
        """Add a request; return False if too many wait already, and it is dropped."""
        with self._news:
            if len(self._requests) >= MAX_REQUESTS:
                return False
            self._requests.append(request)
            self._news.notify_all()
            return True

    def post_view(self, view: BrowserView) -> None:
        """Add to the view that waits: the steps of both, and the orientation of the newer one."""
        with self._news:
            earlier_m = 0.0 if self._view is None else self._view.step_m
            self._view = BrowserView(earlier_m + view.step_m, view.R_map_camera)
            self._news.notify_all()

    def post_change(self, change: ModuleMetadata) -> None:
        """Add to the change of light or exposure that waits; later values replace earlier ones."""
        with self._news:
            self._change = (self._change or ModuleMetadata()).with_update(change)
            self._news.notify_all()

    def forget_view(self) -> None:
        """Drop the view that waits, which belongs to another pose or another driver."""
        with self._news:
            self._view = None

    def begin_anew(self, request: Request) -> int:
        """Have a new driver's first request alone wait; return how many others were dropped.

        Those are of a driver who has left or given the wheel away, and so is the view that waits.
        """
        with self._news:
            dropped = sum(each != request for each in self._requests)
            self._requests.clear()
            self._requests.append(request)
            self._view = None
            self._news.notify_all()
            return dropped

    def has_news(self) -> bool:
        """Return whether anything waits."""
        with self._news:
            return self._is_waiting()

    def wait(self, timeout_s: float) -> None:
        """Wait until there is something, at most ``timeout_s``."""
        with self._news:
            self._news.wait_for(self._is_waiting, timeout_s)

    def take_request(self) -> Request | None:
        """Return the oldest request and remove it; None: there is none."""
        with self._news:
            return self._requests.popleft() if self._requests else None

    def take_view(self) -> BrowserView | None:
        """Return the newest view and remove it; None: there is none."""
        with self._news:
            view, self._view = self._view, None
            return view

    def take_change(self) -> ModuleMetadata | None:
        """Return the change that waits and remove it; None: there is none."""
        with self._news:
            change, self._change = self._change, None
            return change

    def _is_waiting(self) -> bool:
        return bool(self._requests) or self._view is not None or self._change is not None
