"""The state of the simulation for all clients: playing, paused, stopped; its steps and worlds."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace

from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from oaisys_core.errors import NotReadyError, OaisysError
from oaisys_core.types import Pose, SimulatorInfo
from oaisys_ros_bridge.bridge.render_queue import RenderQueue
from oaisys_ros_bridge.bridge.requests import Cancellation, ViewRequest
from oaisys_ros_bridge.bridge.world_topics import WorldTopics
from oaisys_ros_bridge.conversions import pose_to_stamped_msg
from oaisys_ros_bridge.simulation_interfaces.worlds import WorldRequest

STOPPED, PLAYING, PAUSED, QUITTING, NO_WORLD, LOADING_WORLD = range(6)
"""As ``simulation_interfaces/msg/SimulationState`` numbers them; that package may be missing."""

STATE_NAMES = {
    PLAYING: "playing",
    PAUSED: "paused",
    STOPPED: "stopped",
    QUITTING: "quitting",
    NO_WORLD: "without a world",
    LOADING_WORLD: "loading a world",
}


@dataclass(frozen=True)
class _BuiltWorld:
    """The newest world that this bridge has requested."""

    batch_id: int
    request: WorldRequest


class SimulationControl:
    """One state of the simulation for the requests of all clients.

    While the simulation plays, the bridge renders whatever is requested. While it is paused or
    stopped, the bridge renders steps only. A step is one sample: what moves by itself moves on by
    one sample, and the rig is where it was put.

    Args:
        render_queue: Renders, and refuses while the simulation is paused.
        topics: Whose clock a reset sets back.
    """

    def __init__(self, render_queue: RenderQueue, topics: WorldTopics) -> None:
        self._render_queue = render_queue
        self._topics = topics
        self._lock = threading.Lock()
        self._mode = PLAYING
        self._built: _BuiltWorld | None = None
        self._next_pose: Pose | None = None

    @property
    def state(self) -> int:
        """One of the states of ``simulation_interfaces/msg/SimulationState``.

        Raises:
            NotReadyError: There is no simulator.
        """
        link = self._render_queue.require_link()
        if link.building:
            return LOADING_WORLD
        if self._mode == QUITTING and link.state.info is None:
            return QUITTING
        info = self.info()
        return NO_WORLD if info.batch_id == 0 else self._mode

    @property
    def seed(self) -> int | None:
        """Seed of the current world; None: unknown."""
        built, info = self._built, self.info()
        if built is not None and built.batch_id == info.batch_id and built.request.seed is not None:
            return built.request.seed
        return self._render_queue.seed_of(info.batch_id)

    @property
    def rig_pose(self) -> Pose | None:
        """Where the rig is, or will be at the next step; None: unknown."""
        link = self._render_queue.link
        info = None if link is None else link.state.info
        told = None if info is None else info.rig_pose
        return self._next_pose or self._render_queue.rig_pose or told

    def info(self) -> SimulatorInfo:
        """Return the simulator's description; `NotReadyError` where there is none."""
        return self._render_queue.require_link().info

    def resume(self) -> None:
        """Render all requests again."""
        self._enter(PLAYING)

    def pause(self) -> None:
        """Render steps only."""
        self._enter(PAUSED)

    def stop(self) -> None:
        """Reset, and render steps only."""
        before = self._mode
        self._enter(STOPPED)
        try:
            self.restart()
        except OaisysError:
            self._enter(before)
            raise

    def forget(self) -> None:
        """Forget a simulator that was lost; the next one starts in the state playing."""
        self._built = None
        self._next_pose = None
        self._enter(PLAYING)

    def quit(self) -> None:
        """End the simulator."""
        link = self._render_queue.require_link()
        self._enter(QUITTING)  # until the bridge has noticed that it is gone
        link.end_simulation()

    def put_rig(self, pose: Pose) -> None:
        """Set the pose of the rig at the next step."""
        self._next_pose = pose

    def step(self, cancellation: Cancellation | None = None) -> None:
        """Render one sample of a paused simulation, and publish it.

        Raises:
            OaisysError: It is not paused, or the sample fails.
        """
        state = self.state
        if state != PAUSED:
            raise NotReadyError(f"the simulation is {STATE_NAMES[state]}: pause it to step it")
        pose = self._next_pose
        where = None if pose is None else pose_to_stamped_msg(pose, Header())
        self._render_queue.render(ViewRequest(where, is_step=True), cancellation)
        self._next_pose = None

    def build(self, request: WorldRequest) -> int:
        """Build a world and return its batch id."""
        batch_id = self._render_queue.require_link().step_batch(
            seed=request.seed, reuse_stage=request.reuse_stage, metadata=request.metadata
        )
        self._render_queue.forget_world()
        self._next_pose = None
        self._built = _BuiltWorld(batch_id, request)
        return batch_id

    def load(self, request: WorldRequest) -> None:
        """Build a world; the simulation is stopped then."""
        self.build(request)
        self._render_queue.metadata.clear()
        self._enter(STOPPED)

    def restart(self) -> None:
        """Reset the current world: what moves is back at its start, changes are undone.

        Raises:
            OaisysError: Its seed is unknown, or it cannot be built.
        """
        info, seed = self.info(), self.seed
        if seed is None:
            if info.sample_id > 0:
                raise OaisysError("the world's seed is not known: another client has built it")
            self._next_pose = None  # nothing else has changed in it yet
        else:
            built = self._built
            known = built is not None and built.batch_id == info.batch_id
            request = built.request if built is not None and known else WorldRequest()
            # The same seed would make the same ground, so that is kept.
            self.build(replace(request, seed=seed, reuse_stage=True))
        self._render_queue.metadata.clear()
        self.restart_clock()

    def now(self) -> Time:
        """Return the bridge's own time."""
        return self._topics.now()

    @property
    def has_clock(self) -> bool:
        """Whether the bridge publishes a simulated time."""
        return self._topics.has_clock

    def restart_clock(self) -> None:
        """Set simulated time back to 0."""
        self._topics.restart_clock()

    def _enter(self, mode: int) -> None:
        with self._lock:
            self._mode = mode
            paused = mode in (PAUSED, STOPPED)
            name = STATE_NAMES[mode]
            self._render_queue.paused_reason = (
                f"the simulation is {name}: step it, or set its state to playing" if paused else ""
            )
