"""Timed drives: the action ``~/drive``, and what it publishes in the order of simulated time."""

from __future__ import annotations

import time
from collections import Counter

from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node

from oaisys_core.types import ODOMETRY, DriveInstant, DriveOutline
from oaisys_msgs.action import Drive
from oaisys_msgs.msg import SensorCount, TopicCount
from oaisys_ros_bridge.bridge.goal_server import GoalServer, GoalWork
from oaisys_ros_bridge.bridge.render_queue import RenderQueue
from oaisys_ros_bridge.bridge.requests import Cancellation, drive_request
from oaisys_ros_bridge.bridge.simulator_link import SimulatorLink
from oaisys_ros_bridge.bridge.world_topics import DriveTopics, WorldTopics
from oaisys_ros_bridge.conversions import NS_PER_S, duration_from_seconds, pose_to_msg

FEEDBACK_PERIOD_S = 0.1
"""Least time between two messages of feedback."""


class DrivePublisher:
    """Publishes one drive, and fills in its goal's feedback and result.

    Args:
        render_queue: Whose turn it is.
        topics: Where to publish.
        goal: The goal.
        cancellation: Cancels the drive.
        result: Of the goal.
    """

    def __init__(
        self,
        render_queue: RenderQueue,
        topics: WorldTopics,
        goal: ServerGoalHandle,
        cancellation: Cancellation,
        result: Drive.Result,
    ) -> None:
        self._render_queue = render_queue
        self._topics = topics
        self._goal = goal
        self._cancellation = cancellation
        self._result = result
        self._made: Counter[str] = Counter()
        self._fed_back_s = 0.0

    def run(self, link: SimulatorLink) -> None:
        """Drive to the end.

        Raises:
            OaisysError: The drive is refused, fails, or is cancelled.
        """
        request = drive_request(self._goal.request, self._render_queue.frames)
        with (
            self._render_queue.metadata.lend() as metadata,
            link.drive(request, metadata) as stream,
            self._cancellation.stopping_by(stream.cancel),
        ):
            outline = stream.outline
            self._render_queue.announce_batch(outline.batch_id, link)
            with self._topics.driving(outline.start_ns) as published:
                self._result.begin = published.begin
                try:
                    asked_s = time.monotonic()
                    for instant in stream:
                        self._cancellation.check()
                        self._publish(instant, outline, published, time.monotonic() - asked_s)
                        asked_s = time.monotonic()
                finally:
                    self._count(outline, published)

    def _publish(
        self, instant: DriveInstant, outline: DriveOutline, published: DriveTopics, waited_s: float
    ) -> None:
        """Publish everything at one time; samples wait for our mapper and recorders."""
        sample = instant.sample
        if sample is None:
            stamp = published.stamp(instant)
            published.publish(instant, stamp)
        else:
            back_pressure = self._render_queue.back_pressure
            back_pressure.wait_for_room(self._cancellation)
            back_pressure.begin()
            stamp = published.stamp(instant)
            publication = published.begin_sample(sample, instant, stamp)
            for scan in sample.scans:
                publication.add(scan)
            for frame in sample.frames:
                publication.add(frame)
            back_pressure.expect(sample, stamp)
            publication.finish(sample)
            self._render_queue.note(sample, publication, waited_s)
        self._made.update([*instant.sensors, *(reading.sensor for reading in instant.imus)])
        self._made[ODOMETRY] += instant.has_odometry
        now_s = time.monotonic()
        if now_s >= self._fed_back_s + FEEDBACK_PERIOD_S:
            self._fed_back_s = now_s
            elapsed_s = (instant.time_ns - outline.start_ns) / NS_PER_S
            total_s = (outline.end_ns - outline.start_ns) / NS_PER_S
            self._goal.publish_feedback(
                Drive.Feedback(
                    stamp=stamp,
                    elapsed=elapsed_s,
                    duration=total_s,
                    pose=pose_to_msg(instant.pose),
                    elapsed_duration=duration_from_seconds(elapsed_s),
                    total_duration=duration_from_seconds(total_s),
                )
            )

    def _count(self, outline: DriveOutline, published: DriveTopics) -> None:
        """Write into the result what was due, made and published."""
        self._result.sensors = [
            SensorCount(sensor=name, due=due, made=self._made[name])
            for name, due in outline.due.items()
        ]
        self._result.topics = [
            TopicCount(topic=topic, count=count)
            for topic, count in sorted(published.counts.items())
        ]


def drive_server(node: Node, render_queue: RenderQueue, topics: WorldTopics) -> GoalServer:
    """Offer the action; a drive is one request, and other requests wait for its end.

    A drive ends once our mapper and recorders have taken all samples. Otherwise its result says
    which of them have not, and what they have lost.
    """

    def run(goal: ServerGoalHandle, cancellation: Cancellation, result: Drive.Result) -> None:
        # What readers have yet to find missing of earlier samples is not this goal's loss.
        render_queue.back_pressure.wait_until_taken(cancellation)
        before = render_queue.back_pressure.states()
        publisher = DrivePublisher(render_queue, topics, goal, cancellation, result)
        render_queue.in_turn(publisher.run, cancellation)
        render_queue.back_pressure.wait_until_taken(cancellation)
        result.success = True
        missing = [
            f"{each.made} of {each.due} measurements of {each.sensor}"
            for each in result.sensors
            if each.made != each.due
        ]
        result.message = "; ".join((*missing, *render_queue.back_pressure.shortfalls(before)))

    return GoalServer(node, GoalWork(Drive, "~/drive", run, _explain))


def _explain(_goal: ServerGoalHandle, result: Drive.Result, reason: str) -> None:
    """Write into a result why the drive has failed."""
    result.message = reason
