"""Commands that nobody waits for: of poses and trajectories the newest wins."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence

from geometry_msgs.msg import PoseStamped

from oaisys_core.errors import OaisysError
from oaisys_ros_bridge.bridge.turns import Turns

END_TIMEOUT_S = 3.0


class CommandQueue:
    """Renders the poses of the newest command, each in a turn of its own.

    A newer command replaces what is left of the one before as soon as it comes; what renders by
    then is finished first.

    Args:
        turns: Whose turn it is to render.
        render: Renders one pose.
        on_refused: Told why a pose was not rendered; the next one is tried.
    """

    def __init__(
        self,
        turns: Turns,
        render: Callable[[PoseStamped], object],
        on_refused: Callable[[str], object],
    ) -> None:
        self._turns = turns
        self._render = render
        self._on_refused = on_refused
        self._changed = threading.Condition()
        self._poses: deque[PoseStamped] = deque()
        self._closed = False
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name="commands", daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """How many poses are still to be rendered."""
        return len(self._poses)

    def replace(self, poses: Sequence[PoseStamped]) -> None:
        """Render these, and no more of those before."""
        with self._changed:
            self.dropped += len(self._poses)
            self._poses = deque(poses)
            self._changed.notify_all()

    def close(self) -> None:
        """Render nothing more."""
        with self._changed:
            self._closed = True
            self._poses.clear()
            self._changed.notify_all()
        self._thread.join(timeout=END_TIMEOUT_S)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._poses or self._closed)
                if self._closed:
                    return
            with self._turns:
                pose = self._next()
                if pose is not None:
                    self._try(pose)

    def _next(self) -> PoseStamped | None:
        """Return the pose whose turn it is: not the one that was there when it was asked for."""
        with self._changed:
            return self._poses.popleft() if self._poses else None

    def _try(self, pose: PoseStamped) -> None:
        try:
            self._render(pose)
        except OaisysError as error:
            self._on_refused(str(error))
