"""Stamps: whose time they tell, and that nodes with simulated time follow."""

from __future__ import annotations

from typing import Any

import pytest
from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.parameter import Parameter
from ros_peer import User, nanoseconds
from rosgraph_msgs.msg import Clock

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.bridge.stamps import Stamps

pytestmark = pytest.mark.ros


def settings(**values: Any) -> dict[str, Any]:
    return {"publish_clock": False, "clock_step_s": 0.1, **values}


def test_stamps_are_of_the_nodes_clock_and_only_increase(user: User) -> None:
    stamps = Stamps(user.node, settings)
    clock = user.node.get_clock()

    before_ns = clock.now().nanoseconds
    found_ns = [nanoseconds(stamps.next()) for _ in range(1000)]
    found_ns.append(nanoseconds(stamps.between()))

    assert found_ns == sorted(set(found_ns))
    assert before_ns <= found_ns[0]
    assert found_ns[-1] <= clock.now().nanoseconds + len(found_ns)
    assert user.node.count_publishers("/clock") == 0


def test_stamps_go_on_where_the_nodes_clock_stands_still(user: User) -> None:
    user.node.set_parameters([Parameter("use_sim_time", value=True)])
    stamps = Stamps(user.node, settings)  # nobody publishes /clock

    found_ns = [nanoseconds(stamps.next()) for _ in range(5)]

    assert found_ns == [1, 2, 3, 4, 5]


def test_what_is_repeated_never_carries_a_stamp_again(user: User) -> None:
    stamps = Stamps(user.node, settings)
    found_ns = []
    for _ in range(300):
        found_ns.append(nanoseconds(stamps.next()))
        repeated = stamps.repeat_stamp()
        found_ns += [] if repeated is None else [nanoseconds(repeated)]

    assert len(found_ns) > 300
    assert found_ns == sorted(set(found_ns))


def test_nothing_is_repeated_while_simulated_time_stands_still(user: User) -> None:
    own = Stamps(user.node, lambda: settings(publish_clock=True))
    assert own.repeat_stamp() is None
    own.advance(1.0)
    assert own.repeat_stamp() is None
    own.close()

    user.node.set_parameters([Parameter("use_sim_time", value=True)])
    stamps = Stamps(user.node, settings)
    assert stamps.repeat_stamp() is None
    clock = user.node.create_publisher(Clock, "/clock", 10)
    for second in (5, 7):
        told = Clock(clock=Time(sec=second))

        def arrived(told: Clock = told) -> bool:
            clock.publish(told)
            return bool(user.node.get_clock().now().nanoseconds == nanoseconds(told.clock))

        user.wait_until(arrived)
        assert nanoseconds(stamps.repeat_stamp()) == second * 10**9
        assert stamps.repeat_stamp() is None
        assert nanoseconds(stamps.next()) == second * 10**9 + 1


def test_other_nodes_live_in_the_simulated_time(user: User) -> None:
    values = settings(publish_clock=True, clock_step_s=0.25)
    stamps = Stamps(user.node, lambda: values)
    follower = Node(
        "follower",
        context=user.node.context,
        parameter_overrides=[Parameter("use_sim_time", value=True)],
    )
    user.spin_with(follower)

    def follows(stamp: Time) -> bool:
        return follower.get_clock().now().nanoseconds == nanoseconds(stamp)

    first = stamps.next()
    assert nanoseconds(first) == 250_000_000
    user.wait_until(lambda: follows(first))
    assert nanoseconds(stamps.next()) == 500_000_000
    values["clock_step_s"] = 2.0
    later = stamps.next()
    assert nanoseconds(later) == 2_500_000_000
    assert nanoseconds(stamps.between()) == 2_500_000_001
    user.wait_until(lambda: follower.get_clock().now().nanoseconds >= nanoseconds(later))
    stamps.advance(1.0)
    user.wait_until(lambda: follower.get_clock().now().nanoseconds == 3_500_000_000)
    stamps.reset()
    user.wait_until(lambda: follower.get_clock().now().nanoseconds == 0)
    assert nanoseconds(stamps.next()) == 2_000_000_000
    stamps.close()
    follower.destroy_node()


def test_who_tells_the_time_does_not_ask_for_it(user: User) -> None:
    user.node.set_parameters([Parameter("use_sim_time", value=True)])

    with pytest.raises(InvalidInputError, match="publish_clock"):
        Stamps(user.node, lambda: settings(publish_clock=True))
