"""Messages brought together by their exact stamp."""

from oaisys_ros_bridge.subscribing.synchronizer import PENDING, ExactSynchronizer


def test_a_stamp_is_complete_with_its_last_kind_in_any_order():
    synchronizer = ExactSynchronizer(("depth", "info"), ("color",))

    assert synchronizer.add(5, "color", "c5", 0.0) is None
    assert synchronizer.add(6, "depth", "d6", 0.0) is None
    assert synchronizer.add(5, "info", "i5", 0.0) is None
    assert synchronizer.add(5, "depth", "d5", 0.0) == {"color": "c5", "info": "i5", "depth": "d5"}
    assert synchronizer.add(6, "info", "i6", 0.0) is None


def test_stamps_a_nanosecond_apart_are_different_samples():
    synchronizer = ExactSynchronizer(("depth", "info"))

    assert synchronizer.add(5, "depth", "d5", 0.0) is None
    assert synchronizer.add(6, "info", "i6", 0.0) is None


def test_what_lacks_only_a_wanted_kind_is_released_once_it_is_old():
    synchronizer = ExactSynchronizer(("depth", "info"), ("color",))
    synchronizer.add(5, "depth", "d5", 1.0)
    synchronizer.add(5, "info", "i5", 3.0)
    synchronizer.add(6, "depth", "d6", 1.0)

    assert synchronizer.release_older_than(1.0) == []
    assert synchronizer.release_older_than(1.1) == [(5, {"depth": "d5", "info": "i5"})]
    assert synchronizer.release_older_than(9.0) == []


def test_incomplete_stamps_are_bounded_and_the_oldest_goes_first():
    synchronizer = ExactSynchronizer(("depth", "info"))
    for stamp_ns in range(PENDING + 1):
        synchronizer.add(stamp_ns, "depth", stamp_ns, 0.0)

    assert synchronizer.add(0, "info", "i", 0.0) is None
    assert synchronizer.add(PENDING, "info", "i", 0.0) == {"depth": PENDING, "info": "i"}
