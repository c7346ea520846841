"""The rig's last transform is repeated, for those who come between two samples."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path

import pytest
from commands import oaisys_here
from ros_peer import Stage, User, messages_of_samples, nanoseconds
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from served_simulator import FLAT_WORLD
from tf2_msgs.msg import TFMessage
from waiting import LOAD_FACTOR

from oaisys_core.geometry import pose_looking_down
from oaisys_core.world.modules.sensors import START_HEIGHT_M
from oaisys_msgs.msg import MapStatus
from oaisys_ros_bridge.qos import CLOCK_QOS, LATCHED_QOS, TF_QOS

pytestmark = pytest.mark.ros
METRICS = "oaisys_mapper/metrics"
RATE_HZ = 10
REPEATS = 3 * RATE_HZ
PERIODS = 10
"""Of the usual rate, in which nothing may come."""


def stamps_ns(user: User) -> list[int]:
    return [nanoseconds(t.header.stamp) for m in user.received["/tf"] for t in m.transforms]


def heights_m(user: User) -> list[float]:
    return [t.transform.translation.z for m in user.received["/tf"] for t in m.transforms]


@pytest.mark.long
def test_a_late_reader_gets_the_last_transform_and_no_count_is_changed(
    stage: Stage, tmp_path: Path
) -> None:
    """The rate is taken from the stamps, the times of sending: a busy machine only lowers it."""
    user, bag = stage.user, tmp_path / "bag"
    user.listen(MapStatus, METRICS, LATCHED_QOS)
    stage.start_bridge(stage.start_world(FLAT_WORLD).address)
    stage.start_node("mapper")
    user.wait_until_ready()
    recorder = stage.start_node("recorder", "--out", str(bag))
    user.wait_until(lambda: f"recording: {bag}" in recorder.log.read_text())
    user.wait_until_matched(["/tf", "/camera/depth/image_raw"], subscribers=2)
    own_ns = []
    for height_m in (5.0, 6.0):
        answer = user.set_pose(pose_looking_down(0.0, 0.0, height_m))
        assert answer.success, answer.message
        own_ns.append(nanoseconds(answer.stamp))
        if height_m == 5.0:
            user.listen(TFMessage, "/tf", TF_QOS)  # after the sample
            user.wait_until(lambda: len(user.received["/tf"]) >= REPEATS)
    before = len(user.received["/tf"])
    user.wait_until(lambda: len(user.received["/tf"]) > before)
    user.wait_until(lambda: user.received[METRICS][-1].frames_integrated == 2)

    found_ns = stamps_ns(user)
    assert found_ns == sorted(set(found_ns))
    assert own_ns[0] < found_ns[0]
    assert own_ns[1] in found_ns
    first = [height for ns, height in zip(found_ns, heights_m(user), strict=True) if ns < own_ns[1]]
    assert len(first) >= REPEATS
    assert set(first) == {5.0}
    rate_hz = (len(first) - 1) / ((found_ns[len(first) - 1] - found_ns[0]) / 1e9)
    assert RATE_HZ / LOAD_FACTOR <= rate_hz <= 1.1 * RATE_HZ
    assert set(heights_m(user)[len(first) :]) == {6.0}
    assert user.received[METRICS][-1].frames_received == 2
    assert user.received[METRICS][-1].frames_dropped == 0

    assert recorder.end() == 0
    with AnyReader([bag]) as reader:
        tf = [c for c in reader.connections if c.topic == "/tf"]
        recorded = sum(1 for _ in reader.messages(tf))
    assert recorded > REPEATS
    assert messages_of_samples(bag)["/tf"] == 2
    told = oaisys_here("bag", "info", bag).stdout
    assert f"tf2_msgs/msg/TFMessage  2 and {recorded - 2} repeats\n" in told


def past(end_s: float) -> bool:
    return time.monotonic() > end_s


@pytest.mark.parametrize(
    "option",
    [
        pytest.param("publish_clock:=true", marks=pytest.mark.long),
        pytest.param("tf_rate:=0.0", marks=pytest.mark.soak),
    ],
)
def test_nothing_is_repeated_without_time_or_rate(stage: Stage, option: str) -> None:
    user = stage.user
    user.listen(TFMessage, "/tf", TF_QOS)
    user.listen(Clock, "/clock", CLOCK_QOS)
    address = stage.start_world(FLAT_WORLD).address
    stage.start_node("bridge", "--ros-args", "-p", f"address:={address}", "-p", option)
    states = user.received["oaisys_bridge/ready"]
    user.wait_until(lambda: states and states[-1].data)
    user.wait_until_matched(["/tf"])
    for height_m in (5.0, 6.0, 7.0):
        assert user.set_pose(pose_looking_down(0.0, 0.0, height_m)).success
        end_s = time.monotonic() + PERIODS / RATE_HZ
        user.wait_until(partial(past, end_s))
    found = heights_m(user)
    # A new subscriber is a reason to repeat, and a busy bridge may see it after the first pose.
    assert set(found[:-3]) <= {START_HEIGHT_M, 5.0}
    assert found.count(5.0) <= 2
    assert found[-3:] == [5.0, 6.0, 7.0]
