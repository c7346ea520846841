"""Qualities of service of the topics, in one place for publishers and subscribers."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

SENSOR_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
"""Images and clouds. Reliable: best effort loses large messages over UDP."""

LATCHED_QOS = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""Legends, meshes, mounts: the last message reaches those who come late."""

TF_QOS = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)

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
