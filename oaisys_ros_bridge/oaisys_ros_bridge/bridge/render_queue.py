"""Renders views one at a time and publishes their frames as they come."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple, TypeVar

from builtin_interfaces.msg import Time

from oaisys_core.errors import NotReadyError, OaisysError
from oaisys_core.types import Frame, LidarScan, Pose, Sample
from oaisys_ros_bridge.bridge.back_pressure import BackPressure
from oaisys_ros_bridge.bridge.metadata import PendingMetadata
from oaisys_ros_bridge.bridge.requests import Cancellation, ViewRequest, rig_pose
from oaisys_ros_bridge.bridge.simulator_link import SimulatorLink
from oaisys_ros_bridge.bridge.world_topics import WorldTopics
from oaisys_ros_bridge.conversions import nanoseconds
from oaisys_ros_bridge.parameters.table import Settings
from oaisys_ros_bridge.publishing.frame_history import FrameHistory
from oaisys_ros_bridge.publishing.sample_publisher import Publication

R = TypeVar("R")

STOP_TIMEOUT_S = 3.0
ACTIVATION_TIMEOUT_S = 5.0
"""How long a request waits for a bridge that has just found its simulator again."""


class PublishedSample(NamedTuple):
    """A sample, and the stamp of all its messages."""

    sample: Sample
    stamp: Time


@dataclass
class RenderCounts:
    """Counts and durations for diagnostics.

    Attributes:
        rendered: Samples that were published.
        failed: Requests that were refused or failed.
        last_failure: Why the latest of these was or did.
        waiting_commands: Poses of the newest command that are still to be rendered.
        dropped_commands: Poses of older commands that were replaced before they were rendered.
        last_stamp_ns: Stamp of the newest sample.
        last_render_s: How long the simulator took to render it.
        last_transfer_s: How long the bridge waited for it beyond that.
        last_publish_s: How long conversion and publishing took.
    """

    rendered: int = 0
    failed: int = 0
    last_failure: str = ""
    waiting_commands: int = 0
    dropped_commands: int = 0
    last_stamp_ns: int = 0
    last_render_s: float = float("nan")
    last_transfer_s: float = float("nan")
    last_publish_s: float = float("nan")


class RenderQueue:
    """Renders views one at a time, in the order in which they are requested, and publishes them.

    One thread renders. A service call, a pose of a sweep, a command and a simulation step each wait
    for it, so requests that come during a sweep are rendered between two of its poses. A callback
    group of rclpy does not order them like that: of the entities that are ready it runs the one
    that was created first.

    Args:
        topics: Publishes the samples.
        back_pressure: Of our mapper and recorders; the next sample waits for them.
        settings: Returns the bridge's parameters.
        on_sample: Called after each sample.

    Attributes:
        link: The simulator; None while the bridge is unconfigured.
        refusal: Why nothing is rendered; empty: views are rendered once `active` is set.
        active: Set while the bridge is active.
        paused_reason: Why only steps of the simulation are rendered; empty: all views are.
        rig_pose: Where the rig was last; None: unknown.
        metadata: Sent with the next sample; the simulator keeps it from then on.
    """

    def __init__(
        self,
        topics: WorldTopics,
        back_pressure: BackPressure,
        settings: Settings,
        on_sample: Callable[[], object],
    ) -> None:
        self.link: SimulatorLink | None = None
        self.refusal = ""
        self.active = threading.Event()
        self.paused_reason = ""
        self.rig_pose: Pose | None = None
        self.metadata = PendingMetadata()
        self.counts = RenderCounts()
        self.back_pressure = back_pressure
        self._topics = topics
        self._settings = settings
        self._on_sample = on_sample
        self._thread = ThreadPoolExecutor(1, "render")
        self._lock = threading.Lock()
        self._requests = 0
        self._seed: tuple[int, int] | None = None
        self._current: Cancellation | None = None
        self._idle = threading.Event()
        self._idle.set()

    @property
    def frames(self) -> FrameHistory:
        """Where the frames are in which poses may come; `NotReadyError` while unconfigured."""
        return self._topics.frames

    @property
    def map_frame(self) -> str:
        """Frame of the world."""
        return str(self._settings()["map_frame"])

    @property
    def waiting(self) -> int:
        """How many requests wait for the one that is being served."""
        return max(self._requests - 1, 0)

    @property
    def activity(self) -> str:
        """``rendering``, ``waiting`` (for the simulator or a reader) or ``idle``."""
        if not self._idle.is_set():
            return "rendering"
        return "waiting" if self._requests else "idle"

    def require_link(self) -> SimulatorLink:
        """Return the simulator; `NotReadyError` while the bridge is unconfigured."""
        if self.link is None:
            raise NotReadyError("the bridge is unconfigured: configure it first")
        return self.link

    def seed_of(self, batch_id: int) -> int | None:
        """Return the seed of a batch; None: no sample of it has been rendered."""
        known = self._seed
        return known[1] if known is not None and known[0] == batch_id else None

    def forget_world(self) -> None:
        """Forget pose and seed of a world that no longer exists."""
        self.rig_pose = None
        self._seed = None

    def stop(self, reason: str) -> None:
        """Cancel the render that is under way, and wait for its end."""
        current = self._current
        if current is not None:
            current.request(reason)
            self._idle.wait(STOP_TIMEOUT_S)

    def render(
        self, request: ViewRequest, cancellation: Cancellation | None = None
    ) -> PublishedSample:
        """Render and publish one view.

        Waits for its turn, and while our mapper or recorders are too far behind. Frames are
        published as they come. If the render then fails, ``~/sample_info`` never announces their
        stamp: they belong to no sample.

        Raises:
            OaisysError: The request is refused, fails, or is cancelled.
        """
        return self._in_turn(lambda: self._serve(request, cancellation or Cancellation()))

    def render_next(self, next_request: Callable[[], ViewRequest | None]) -> None:
        """Render what ``next_request`` returns once it is this caller's turn; nothing for None.

        Raises:
            OaisysError: See `render`.
        """

        def serve() -> None:
            request = next_request()
            if request is not None:
                self._serve(request, Cancellation())

        self._in_turn(serve)

    def in_turn(self, work: Callable[[SimulatorLink], R], cancellation: Cancellation) -> R:
        """Do work with the simulator, other than rendering a view, once it is this caller's turn.

        Raises:
            OaisysError: The bridge renders nothing now, or the work fails or is cancelled.
        """

        def serve() -> R:
            with self._serving(cancellation) as link:
                if self.paused_reason:
                    raise NotReadyError(self.paused_reason)
                return work(link)

        return self._in_turn(serve)

    def update_topics(self) -> None:
        """Follow a change of the simulator, after the views that were requested before.

        On the thread that renders, so that an older world is never announced after a newer one.
        """
        self._thread.submit(self._update_topics).add_done_callback(Future.result)

    def _update_topics(self) -> None:
        info = None if self.link is None else self.link.state.info
        if info is not None:
            self._topics.update(info)
            if self.active.is_set():
                self._topics.announce(info)

    def _in_turn(self, work: Callable[[], R]) -> R:
        """Do work on the thread that renders, after all that was requested before."""
        with self._lock:
            self._requests += 1
        try:
            return self._thread.submit(work).result()
        finally:
            with self._lock:
                self._requests -= 1

    def _serve(self, request: ViewRequest, cancellation: Cancellation) -> PublishedSample:
        with self._serving(cancellation) as link:
            self.back_pressure.wait_for_room(cancellation)
            with self._topics.rendering():
                return self._render(request, link, cancellation)

    @contextmanager
    def _serving(self, cancellation: Cancellation) -> Iterator[SimulatorLink]:
        """Lend the simulator to one request."""
        try:
            cancellation.check()
            link = self._ready_link(cancellation)
            self._current = cancellation  # from here on, `stop` can cancel it
            self._idle.clear()
            try:
                yield link
            finally:
                self._current = None
                self._idle.set()
        except OaisysError as error:
            self.counts.failed += 1
            self.counts.last_failure = str(error)
            raise

    def _ready_link(self, cancellation: Cancellation) -> SimulatorLink:
        """Return a simulator that can render now; look for it at once if it was lost.

        Waits for a simulator that is starting its worker.

        Raises:
            OaisysError: There is none, or the request is cancelled.
        """
        link = self.link
        if self.refusal or link is None:
            raise NotReadyError(self.refusal)
        self._wait(link.wait_for_worker, link, cancellation)
        if not self.active.is_set() and not (
            link.state.ready and self.active.wait(ACTIVATION_TIMEOUT_S)
        ):
            raise NotReadyError(link.state.reason or "the bridge is not active yet")
        return link

    def _wait(
        self,
        wait: Callable[[Callable[[], bool]], None],
        link: SimulatorLink,
        cancellation: Cancellation,
    ) -> None:
        """Wait for a worker until the request is cancelled or refused; then raise why."""
        with cancellation.stopping_by(link.wake_waiters):
            wait(lambda: bool(cancellation.reason or self.refusal))
        cancellation.check()
        if self.refusal:
            raise NotReadyError(self.refusal)

    def _render(
        self, request: ViewRequest, link: SimulatorLink, cancellation: Cancellation
    ) -> PublishedSample:
        if self.paused_reason and not request.is_step:
            raise NotReadyError(self.paused_reason)
        pose = None
        if request.pose is not None:
            pose = rig_pose(request.pose, request.sensor, link.info, self.frames)
        try:
            return self._publish(request, pose, link, cancellation)
        except NotReadyError:
            if not link.initial_batch:
                raise
            self._wait(link.find_worker, link, cancellation)  # a restarted server builds a batch
            if not link.state.ready:
                raise NotReadyError(link.state.reason) from None
            return self._publish(request, pose, link, cancellation)

    def _publish(
        self,
        request: ViewRequest,
        pose: Pose | None,
        link: SimulatorLink,
        cancellation: Cancellation,
    ) -> PublishedSample:
        """Pull the frames of a sample from the simulator, and publish each."""
        asked_s = time.monotonic()
        with (
            self.metadata.lend() as metadata,
            link.sample_stream(pose, request, metadata) as stream,
            cancellation.stopping_by(stream.cancel),
        ):
            frames = iter(stream)
            first: list[Frame | LidarScan] = list(filter(None, [next(frames, None)]))
            self.announce_batch(stream.outline.batch_id, link)
            self.back_pressure.begin()
            publication = self._topics.begin(stream.outline)
            for frame in chain(first, frames):
                publication.add(frame)
            sample = stream.sample
        waited_s = time.monotonic() - asked_s - publication.seconds
        self.back_pressure.expect(sample, publication.stamp)
        if publication.wants_boxes:
            publication.publish_boxes(link.find_objects(publication.find_shown_objects()))
        publication.finish(sample)
        self.note(sample, publication, waited_s)
        return PublishedSample(sample, publication.stamp)

    def announce_batch(self, batch_id: int, link: SimulatorLink) -> None:
        """Announce the batch of a sample that is about to be published, if it is a new one."""
        if link.info.batch_id != batch_id:
            link.check()  # another client has stepped a batch
        self._topics.announce(link.info)

    def note(self, sample: Sample, publication: Publication, waited_s: float) -> None:
        """Count a sample that was published, ``waited_s`` after it was requested."""
        counts = self.counts
        counts.rendered += 1
        counts.last_stamp_ns = nanoseconds(publication.stamp)
        counts.last_render_s = sample.render_time_s
        # A sample from the cache was rendered when it was first asked for.
        rendered_s = 0.0 if sample.from_cache else sample.render_time_s
        counts.last_transfer_s = max(waited_s - rendered_s, 0.0)
        counts.last_publish_s = publication.seconds
        self.rig_pose = sample.rig_pose
        self._seed = (sample.batch_id, sample.provenance.batch_seed)
        self._on_sample()
