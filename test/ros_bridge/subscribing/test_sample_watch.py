"""Losses that the middleware reports reach the receipts and whoever judges an experiment."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import Any

import pytest
from std_msgs.msg import Header

from oaisys_msgs.msg import Loss, SampleInfo, SampleReceipt, SensorPose
from oaisys_ros_bridge.bridge.back_pressure import state_of
from oaisys_ros_bridge.conversions import stamp_from_nanoseconds
from oaisys_ros_bridge.experiments.status import StackStatus
from oaisys_ros_bridge.nodes.background_node import BackgroundNode
from oaisys_ros_bridge.qos import LATCHED_QOS, SENSOR_QOS
from oaisys_ros_bridge.subscribing.ledger_state import shortfall
from oaisys_ros_bridge.subscribing.sample_watch import camera_poses, counting_losses, losses_msg

RECORDER, TF = "/oaisys_recorder", "/tf"


def test_the_middleware_s_losses_are_counted_by_topic() -> None:
    lost: Counter[str] = Counter()
    for topic, new in ((TF, 3), ("/camera/depth/image_raw", 1), (TF, 2)):
        callbacks: Any = counting_losses(lost, topic, SENSOR_QOS)
        callbacks.message_lost(SimpleNamespace(total_count=9, total_count_change=new))
    assert lost == {TF: 5, "/camera/depth/image_raw": 1}
    receipt = SampleReceipt(node=RECORDER, samples=7, lost_by_middleware=losses_msg(lost))
    assert shortfall(state_of(receipt)) == (
        f"the middleware lost messages of /camera/depth/image_raw 1, {TF} 5"
    )


@pytest.mark.ros
def test_lidars_are_none_of_the_cameras_of_a_sample() -> None:
    """A mapper takes the only camera of a rig, whatever its name, also beside a lidar."""
    camera = SensorPose(sensor="front", modalities=["rgb", "depth"])
    info = SampleInfo(sensors=[camera, SensorPose(sensor="lidar", modalities=["points"])])
    assert camera_poses(info) == [camera]


def test_of_latched_topics_only_the_last_message_counts() -> None:
    assert counting_losses(Counter(), TF, LATCHED_QOS) is None


@pytest.mark.ros
def test_an_experiment_is_told_what_the_middleware_lost_of_each_of_two_recorders(
    ros_domain_id: int,
) -> None:
    """It was told of neither, and of two recorders of one name only the last was known."""
    header = Header(stamp=stamp_from_nanoseconds(5))
    with BackgroundNode("judge") as client:
        status = StackStatus(client)
        client.start()
        for instance, lost in ((1, [Loss(what=TF, count=3)]), (2, [])):
            status._on_receipt(
                SampleReceipt(
                    header=header,
                    node=RECORDER,
                    instance=instance,
                    samples=9,
                    lost_by_middleware=lost,
                )
            )
        told = status.shortfalls(5, 0.0)
        late = status.shortfalls(6, 0.0)
    assert told == [f"{RECORDER}: the middleware lost messages of {TF} 3"]
    sentence = f"{RECORDER}: after 0 s it had taken 9 samples, but not the last one"
    assert late.count(sentence) == 2
