"""Requests for views, whoever makes them: rendered one at a time, and published."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped

from oaisys_core.errors import NotReadyError, OaisysError
from oaisys_core.types import Frame, Pose, Sample, SampleOutline, SimulatorInfo
from oaisys_ros_bridge.bridge.cancellation import Cancellation
from oaisys_ros_bridge.bridge.pending_metadata import PendingMetadata
from oaisys_ros_bridge.bridge.readers import Readers
from oaisys_ros_bridge.bridge.requests import checked_modalities, rig_pose
from oaisys_ros_bridge.bridge.simulator_link import SimulatorLink
from oaisys_ros_bridge.bridge.turns import Turns
from oaisys_ros_bridge.publishing.publication import Publication
from oaisys_ros_bridge.publishing.stamps import nanoseconds

STOP_TIMEOUT_S = 3.0


@dataclass(frozen=True)
class View:
    """What somebody wants to see.

    Attributes:
        pose: Where the rig or the sensor goes; None: it stays.
        sensor: Name of the sensor that renders, and that the pose is of; empty: the rig, all.
        modalities: What to render; none: all.
        is_step: Whether it is a step of a paused simulation, which renders nothing else.
    """

    pose: PoseStamped | None
    sensor: str = ""
    modalities: Sequence[str] = ()
    is_step: bool = False


@dataclass
class Counts:
    """What was done so far, for diagnostics.

    Attributes:
        rendered: Samples that were published.
        failed: Requests that were refused or failed.
        last_stamp_ns: Of the newest sample.
        last_render_s: What the simulator took to render it.
        last_transfer_s: What the bridge waited for it besides.
        last_publish_s: What conversion and publishing took.
    """

    rendered: int = 0
    failed: int = 0
    last_stamp_ns: int = 0
    last_render_s: float = float("nan")
    last_transfer_s: float = float("nan")
    last_publish_s: float = float("nan")


def _set_event() -> threading.Event:
    event = threading.Event()
    event.set()
    return event


@dataclass
class Renderer:
    """Renders views one at a time, in the order in which they are asked for.

    A service call, a goal's next pose, a command and a step of the simulation each wait for one
    turn: what comes meanwhile goes between two poses of a sweep. Stamps only increase.

    Attributes:
        turns: Whose turn it is to use the simulator.
        ready_link: Returns the link of a bridge that may render now; raises `NotReadyError`.
        begin: Begins to publish a sample.
        map_frame: Returns the frame of the world.
        readers: Who has to take the samples, and is waited for before another one.
        on_sample: Told after each sample.
        paused_reason: Why only steps of the simulation are rendered; empty: all is.
        rig_pose: Where the rig was last put; None: that is not known.
        metadata: What goes with the next sample; the simulator keeps it from then on.
    """

    turns: Turns
    ready_link: Callable[[], tuple[SimulatorLink, SimulatorInfo]]
    begin: Callable[[SampleOutline], Publication]
    map_frame: Callable[[], str]
    readers: Readers
    on_sample: Callable[[], None] = lambda: None
    paused_reason: str = ""
    rig_pose: Pose | None = None
    metadata: PendingMetadata = field(default_factory=PendingMetadata)
    counts: Counts = field(default_factory=Counts)
    _seed: tuple[int, int] | None = None
    _current: Cancellation | None = None
    _idle: threading.Event = field(default_factory=_set_event)

    def forget_world(self) -> None:
        """Forget what is known of a world that has gone."""
        self.rig_pose = None
        self._seed = None

    def seed_of(self, batch_id: int) -> int | None:
        """Return what a batch was drawn from, if a sample of it has been rendered."""
        known = self._seed
        return known[1] if known is not None and known[0] == batch_id else None

    @property
    def activity(self) -> str:
        """What it does now: ``rendering``, ``waiting`` or ``idle``."""
        if not self._idle.is_set():
            return "rendering"
        return "waiting" if self.turns.taken else "idle"

    def stop(self, reason: str) -> None:
        """End the render that is under way, and wait for that."""
        current = self._current
        if current is not None:
            current.request(reason)
            self._idle.wait(STOP_TIMEOUT_S)

    def render(self, view: View, cancellation: Cancellation | None = None) -> tuple[Sample, Time]:
        """Render and publish one view; return the sample and the stamp of all its messages.

        Waits for our own readers first, where they are too far behind to get all of it.

        What is ready goes out at once. Where the render then fails, ``~/sample_info`` never tells
        of that stamp: its images belong to no sample.

        Raises:
            OaisysError: It is refused, fails, or is cancelled.
        """
        cancellation = cancellation or Cancellation()
        try:
            with self.turns:
                cancellation.check()
                link, info = self.ready_link()
                self._current = cancellation
                self._idle.clear()
                try:
                    self.readers.wait_for_room(cancellation)
                    sample, stamp = self._rendered(view, link, info, cancellation)
                finally:
                    self._current = None
                    self._idle.set()
        except OaisysError:
            self.counts.failed += 1
            raise
        return sample, stamp

    def _rendered(
        self, view: View, link: SimulatorLink, info: SimulatorInfo, cancellation: Cancellation
    ) -> tuple[Sample, Time]:
        if self.paused_reason and not view.is_step:
            raise NotReadyError(self.paused_reason)
        pose = None
        if view.pose is not None:
            pose = rig_pose(view.pose, view.sensor, info, self.map_frame())
        modalities = checked_modalities(view.modalities, view.sensor, info)
        sensors = [view.sensor] if view.sensor else []
        begun: list[Publication] = []

        def publish(outline: SampleOutline, frames: tuple[Frame, ...]) -> None:
            if not begun:
                self.readers.begin()
                begun.append(self.begin(outline))
            begun[0].add(frames)

        asked_s = time.monotonic()
        with self.metadata.sent() as metadata:
            sample = link.render(
                pose,
                metadata=metadata,
                modalities=modalities,
                sensors=sensors,
                on_frames=publish,
                cancellation=cancellation,
            )
        waited_s = time.monotonic() - asked_s - (begun[0].seconds if begun else 0.0)
        if not begun:
            publish(sample.outline, ())
        publication = begun[0]
        self.readers.expect(sample, publication.stamp)
        publication.finish(sample)
        self._note(sample, publication, waited_s)
        return sample, publication.stamp

    def _note(self, sample: Sample, publication: Publication, waited_s: float) -> None:
        self.counts.rendered += 1
        self.counts.last_stamp_ns = nanoseconds(publication.stamp)
        self.counts.last_render_s = sample.render_time_s
        # A sample from the cache was rendered when it was first asked for.
        rendered_s = 0.0 if sample.from_cache else sample.render_time_s
        self.counts.last_transfer_s = max(waited_s - rendered_s, 0.0)
        self.counts.last_publish_s = publication.seconds
        self.rig_pose = sample.rig_pose
        self._seed = (sample.batch_id, sample.provenance.batch_seed)
        self.on_sample()
