"""Qualities of service of the topics, in one place for publishers and subscribers."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

SENSOR_DEPTH = 5

WINDOW = SENSOR_DEPTH - 1
"""Samples that our mapper and recorders may be behind before the bridge waits for them: the
publishers still hold the messages of all of these."""


def _reliable(depth: int) -> QoSProfile:
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)


def _latch(depth: int) -> QoSProfile:
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


SENSOR_QOS = _reliable(SENSOR_DEPTH)
"""Images and clouds. Reliable: best effort loses large messages over UDP."""

DEEP_QOS = _reliable(50)
"""Images and clouds as the mapper subscribes to them. At most `WINDOW` are queued while the bridge
waits for the mapper; more where it does not wait, or where somebody else publishes."""

SMALL_MESSAGE_QOS = _reliable(1000)
"""``sample_info``, and transforms as mapper and recorder subscribe to them: small messages, many
of them, of which none may be lost."""

TF_QOS = _reliable(100)

MOTION_QOS = _reliable(5000)
"""Transforms, odometry and inertial measurements, of which a drive has many between two samples."""

CLOCK_QOS = _reliable(10)
"""Simulated time; nodes subscribe to it best effort."""

MAX_WAITING = 256
"""Requests of one service that may wait beside the one that is being served; others are refused."""

SERVICE_QOS = _reliable(4 * MAX_WAITING)
"""Requests and answers of a service. The middleware drops what is more, without a word; a node
takes requests much faster than it serves them."""

NEWEST_QOS = _reliable(1)
"""Commands of which only the newest counts."""

LATCHED_QOS = _latch(1)
"""Legends, meshes, mounts, receipts: late subscribers get the last message."""

PATH_QOS = _latch(2 * SENSOR_DEPTH)
"""The path: published with each sample, and again for late subscribers."""

LATCHED_HISTORY_QOS = _latch(100)
"""Frusta, which are published one by one; and subscriptions to what several nodes latch: receipts,
static transforms."""
