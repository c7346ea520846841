"""A simulator as one with a state: playing, paused, stopped; steps, resets and worlds."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

from std_msgs.msg import Header

from oaisys_core.errors import NotReadyError, OaisysError
from oaisys_core.types import Pose, SimulatorInfo
from oaisys_ros_bridge.bridge.cancellation import Cancellation
from oaisys_ros_bridge.bridge.rendering import Renderer, View
from oaisys_ros_bridge.bridge.simulator_link import SimulatorLink
from oaisys_ros_bridge.conversions import pose_to_stamped_msg
from oaisys_ros_bridge.publishing.world_topics import WorldTopics
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
class _Built:
    """The world that stands, as far as this bridge has asked for it."""

    batch_id: int
    request: WorldRequest


class Simulation:
    """Gives the requests of all clients one state.

    Playing, the bridge renders whatever it is asked for. Paused or stopped, it renders steps alone,
    each of which is one sample: things that move by themselves go on by one sample, the rig is
    where it was put.

    Args:
        renderer: Renders, and refuses while the simulation is paused.
        link: Returns the simulator; raises `NotReadyError` where the bridge is unconfigured.
        topics: Whose clock begins again with a reset.
    """

    def __init__(
        self, renderer: Renderer, link: Callable[[], SimulatorLink], topics: WorldTopics
    ) -> None:
        self._renderer = renderer
        self._link = link
        self._topics = topics
        self._lock = threading.Lock()
        self._mode = PLAYING
        self._built: _Built | None = None
        self._next_pose: Pose | None = None

    @property
    def state(self) -> int:
        """One of the states of ``simulation_interfaces/msg/SimulationState``.

        Raises:
            NotReadyError: There is no simulator.
        """
        link = self._link()
        if link.building:
            return LOADING_WORLD
        if self._mode == QUITTING and link.state.info is None:
            return QUITTING
        info = self.info()
        return NO_WORLD if info.batch_id == 0 else self._mode

    @property
    def seed(self) -> int | None:
        """What the world that stands was drawn from; None: that is not known."""
        built, info = self._built, self.info()
        if built is not None and built.batch_id == info.batch_id and built.request.seed is not None:
            return built.request.seed
        return self._renderer.seed_of(info.batch_id)

    @property
    def rig_pose(self) -> Pose | None:
        """Where the rig is, or will be at the next step; None: that is not known."""
        return self._next_pose or self._renderer.rig_pose

    def link(self) -> SimulatorLink:
        """Return the simulator; `NotReadyError` where the bridge is unconfigured."""
        return self._link()

    def info(self) -> SimulatorInfo:
        """Return what the simulator is; `NotReadyError` where there is none."""
        state = self._link().state
        if state.info is None:
            raise NotReadyError(state.reason)
        return state.info

    def resume(self) -> None:
        """Render everything again."""
        self._enter(PLAYING)

    def pause(self) -> None:
        """Render steps alone."""
        self._enter(PAUSED)

    def stop(self) -> None:
        """Reset, and render steps alone."""
        before = self._mode
        self._enter(STOPPED)
        try:
            self.restart()
        except OaisysError:
            self._enter(before)
            raise

    def forget(self) -> None:
        """Forget a simulator that has gone; another one plays from its start."""
        self._built = None
        self._next_pose = None
        self._enter(PLAYING)

    def quit(self) -> None:
        """End the simulator."""
        link = self._link()
        self._enter(QUITTING)  # until the bridge has noticed that it is gone
        link.end_simulation()

    def put_rig(self, pose: Pose) -> None:
        """Have the next step look from a pose."""
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
        self._renderer.render(View(where, is_step=True), cancellation)
        self._next_pose = None

    def build(self, request: WorldRequest) -> int:
        """Build a world and return its batch id."""
        batch_id = self._link().step_batch(
            seed=request.seed, reuse_stage=request.reuse_stage, metadata=request.metadata
        )
        self._renderer.forget_world()
        self._next_pose = None
        self._built = _Built(batch_id, request)
        return batch_id

    def load(self, request: WorldRequest) -> None:
        """Build a world and stop there."""
        self.build(request)
        self._renderer.metadata.clear()
        self._enter(STOPPED)

    def restart(self) -> None:
        """Begin the world that stands again: what moves is where it began, changes are gone.

        Raises:
            OaisysError: It is not known what it was drawn from, or it cannot be built.
        """
        info, seed = self.info(), self.seed
        if seed is None:
            if info.sample_id > 0:
                raise OaisysError("the world's seed is not known: another client has built it")
            self._next_pose = None  # nothing else has happened in it yet
        else:
            built = self._built
            known = built is not None and built.batch_id == info.batch_id
            request = built.request if built is not None and known else WorldRequest()
            # The ground stays as it is: the same seed would make the same.
            self.build(replace(request, seed=seed, reuse_stage=True))
        self._renderer.metadata.clear()
        self.restart_clock()

    @property
    def has_clock(self) -> bool:
        """Whether time is simulated."""
        return self._topics.has_clock

    def restart_clock(self) -> None:
        """Let simulated time begin again."""
        self._topics.restart_clock()

    def _enter(self, mode: int) -> None:
        with self._lock:
            self._mode = mode
            paused = mode in (PAUSED, STOPPED)
            name = STATE_NAMES[mode]
            self._renderer.paused_reason = (
                f"the simulation is {name}: step it, or set its state to playing" if paused else ""
            )
