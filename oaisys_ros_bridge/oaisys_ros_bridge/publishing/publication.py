"""A sample on its way to its topics: what is ready goes out, all of it with one stamp."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from builtin_interfaces.msg import Time

from oaisys_core.types import DEPTH, RGB, Frame, FrameName, Sample, SampleOutline
from oaisys_ros_bridge.publishing.sample_publisher import SamplePublisher, measured


class Publication:
    """Publishes the frames of one sample as they come.

    Pose and transforms first; depth, labels and all else that needs no light next; then colours; a
    sensor's cloud once its colour is there, or at once where it will have none; path, viewpoints
    and sample_info last, and only if the sample gets complete. Parameters that change meanwhile
    hold from the next sample on.

    Attributes:
        seconds: Spent on conversion and publishing so far.
    """

    def __init__(self, publisher: SamplePublisher, outline: SampleOutline, stamp: Time) -> None:
        """Publish where the rig is."""
        self.stamp = stamp
        self.seconds = 0.0
        self._publisher = publisher
        self._outline = outline
        self._options = publisher.options()
        self._frames: dict[FrameName, Frame] = {}
        with self._timed():
            publisher.publish_pose(outline, stamp, self._options)

    def add(self, frames: tuple[Frame, ...]) -> None:
        """Publish frames that are ready, and the clouds that they complete."""
        with self._timed():
            self._add(frames)

    def _add(self, frames: tuple[Frame, ...]) -> None:
        seen = [measured(frame, self._outline, self._options) for frame in frames]
        self._publisher.publish_frames(seen, self.stamp, self._options)
        for frame in seen:
            self._frames[FrameName(frame.sensor, frame.modality)] = frame
            if frame.modality in (DEPTH, RGB) and self._has_cloud(frame.sensor):
                images = self._frames.values()
                self._publisher.publish_cloud(frame.sensor, images, self.stamp, self._options)

    def finish(self, sample: Sample) -> None:
        """Say that this was all of it."""
        with self._timed():
            self._publisher.finish(sample, self.stamp, self._options)

    @contextmanager
    def _timed(self) -> Iterator[None]:
        """Count the time as spent on publishing."""
        started_s = time.monotonic()
        yield
        self.seconds += time.monotonic() - started_s

    def _has_cloud(self, sensor: str) -> bool:
        """Return whether everything has come that a sensor's cloud is made of."""
        wanted = {FrameName(sensor, DEPTH), FrameName(sensor, RGB)}.intersection(
            self._outline.frames
        )
        return wanted <= self._frames.keys()
