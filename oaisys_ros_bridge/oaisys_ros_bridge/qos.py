"""Qualities of service of the topics, in one place for publishers and subscribers."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

SENSOR_DEPTH = 5

SENSOR_QOS = QoSProfile(depth=SENSOR_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
"""Images and clouds. Reliable: best effort loses large messages over UDP."""

WINDOW = SENSOR_DEPTH - 1
"""Samples that our own readers may be behind before the bridge waits for them: publishers still
hold the messages of all of these."""

DEEP_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.RELIABLE)
"""Images and clouds as the mapper listens to them: no more than `WINDOW` wait there where the
bridge waits, and as many as this where it does not, or somebody else publishes."""

SAMPLE_INFO_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""What samples are counted against: small, and kept far longer than what is counted."""

RECEIPTS_QOS = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""For whoever listens to the receipts of several readers, each of which latches its last one."""

PATH_QOS = QoSProfile(
    depth=2 * SENSOR_DEPTH,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""The path with each sample, and in between for those who come late."""

LATCHED_QOS = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""Legends, meshes, mounts, receipts: the last message reaches those who come late."""

TF_QOS = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)

DEEP_TF_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Transforms as mapper and recorder listen to them: others publish there, too."""

TF_STATIC_QOS = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""For those who listen: every publisher of fixed frames latches a message of its own."""

TRACE_QOS = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""Frusta, which come one by one: none may be lost to whoever is slow."""

NEWEST_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
"""Commands of which only the newest counts."""

CLOCK_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""Simulated time; nodes listen to it best effort."""
