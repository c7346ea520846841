"""What came of announced samples, message by message."""

from __future__ import annotations

import threading
import tracemalloc
from collections.abc import Iterable

import numpy as np
import pytest

from oaisys_ros_bridge.bags.losses import BagLosses, MissingNumbers
from oaisys_ros_bridge.subscribing.ledger_state import LedgerState, SampleName, shortfall
from oaisys_ros_bridge.subscribing.sample_ledger import LOST_AFTER_S, SampleLedger

INFO = "/oaisys_bridge/sample_info"
DEPTH, COLOR, POSE = "/camera/depth/image_raw", "/camera/color/image_raw", "/tf"
TOPICS = (DEPTH, COLOR, POSE)


class Watched:
    """A ledger with a clock of the test's own."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.settled = 0
        self.ledger = SampleLedger(INFO, self._on_settled, lambda: self.now_s)

    def _on_settled(self) -> None:
        self.settled += 1

    def announce(self, number: int, *, topics: Iterable[str] = TOPICS, map_of: str = "") -> None:
        needed = (DEPTH, POSE) if map_of else ()
        self.ledger.announce(name(number), number, set(topics), needed=needed, result=map_of)

    def arrive(self, number: int, *topics: str) -> None:
        for topic in topics or TOPICS:
            self.ledger.arrive(topic, name(number).stamp_ns)


def name(number: int) -> SampleName:
    return SampleName(1, number, 1000 * number)


@pytest.fixture
def watched() -> Watched:
    return Watched()


def test_a_sample_is_settled_once_all_of_it_has_come_before_or_after_its_announcement(watched):
    watched.arrive(1, DEPTH)
    watched.announce(1)
    watched.arrive(1, COLOR)
    assert (watched.ledger.open, watched.settled) == (1, 0)

    watched.arrive(1, POSE)

    assert (watched.ledger.open, watched.settled) == (0, 1)
    state = watched.ledger.state
    assert (state.announced, state.settled, state.incomplete, state.lost) == (1, 1, 0, {})
    assert state.last == name(1)
    assert shortfall(state) == ""


def test_a_message_is_lost_once_a_later_sample_has_its_own(watched):
    watched.announce(1)
    watched.arrive(1, DEPTH, POSE)
    watched.announce(2)
    watched.arrive(2, DEPTH)
    assert watched.ledger.open == 2

    watched.arrive(2, COLOR)

    assert watched.ledger.open == 1
    assert watched.ledger.state.lost == {COLOR: 1}
    assert shortfall(watched.ledger.state) == f"1 of 2 samples are incomplete; lost: {COLOR} 1"


def test_what_is_published_before_its_announcement_tells_of_earlier_losses_too(watched):
    watched.announce(1)
    watched.arrive(1, DEPTH, COLOR)
    watched.arrive(2)
    assert watched.ledger.open == 1

    watched.announce(2)

    assert watched.ledger.open == 0
    assert watched.ledger.state.lost == {POSE: 1}


def test_a_message_that_never_comes_is_lost_after_a_while_and_found_when_it_comes(watched):
    watched.announce(1)
    watched.arrive(1, DEPTH, POSE)
    watched.now_s = LOST_AFTER_S
    watched.ledger.expire()
    assert watched.ledger.state.incomplete == 0

    watched.now_s += 0.1
    watched.ledger.expire()
    assert (watched.ledger.open, watched.ledger.state.lost) == (0, {COLOR: 1})

    watched.arrive(1, COLOR)
    assert (watched.ledger.state.incomplete, watched.ledger.state.lost) == (0, {})


def test_a_modality_that_was_not_rendered_is_no_loss(watched):
    watched.announce(1, topics=(COLOR,))
    watched.arrive(1, COLOR)
    watched.announce(2)
    watched.arrive(2)
    assert watched.ledger.state.lost == {}
    assert watched.ledger.state.settled == 2


def test_an_announcement_is_waited_for_whatever_comes_first(watched):
    watched.announce(1)
    watched.arrive(1)
    watched.ledger.wait_for_announcement(name(1), 1, 0.0)
    assert watched.ledger.state == LedgerState(1, 1, 0, {}, name(1))
    threading.Timer(0.1, watched.announce, (2,)).start()

    watched.ledger.wait_for_announcement(name(2), 2, 60.0)

    assert watched.ledger.open == 1


def test_an_announcement_that_does_not_come_is_counted_until_it_comes(watched):
    watched.announce(1)
    watched.arrive(1)

    watched.ledger.wait_for_announcement(name(3), 3, 0.0)

    state = watched.ledger.state
    assert (state.announced, state.incomplete) == (3, 2)
    assert state.lost == dict.fromkeys((INFO, *TOPICS), 2)
    watched.announce(3)
    watched.arrive(3)
    state = watched.ledger.state
    assert (state.announced, state.incomplete, state.last) == (3, 1, name(3))
    watched.announce(5)
    assert watched.ledger.state.announced == 5


@pytest.mark.parametrize("is_first", [False, True])
def test_before_the_first_announcement_only_who_was_there_counts(watched, is_first):
    if is_first:
        watched.ledger.expect_from_first()
    watched.ledger.wait_for_announcement(name(2), 2, 0.0)
    assert watched.ledger.state.incomplete == 2 * is_first
    watched.announce(3)
    watched.arrive(3)
    assert watched.ledger.state.announced == 3 if is_first else 1
    watched.ledger.expect_from_first()
    assert watched.ledger.state.incomplete == 2


def test_of_another_bridge_nothing_is_counted_that_was_not_announced(watched):
    for number in (1, 2, 3):
        watched.announce(number)
        watched.arrive(number)
    watched.ledger.wait_for_announcement(SampleName(1, 2, 77), 2, 0.0)
    assert watched.ledger.state == LedgerState(3, 3, 0, {}, name(3))
    watched.announce(3)
    assert watched.ledger.state.announced == 4


def test_announcements_that_are_lost_are_counted_with_all_that_belongs_to_them(watched):
    watched.announce(1)
    watched.arrive(1)
    watched.announce(4)
    watched.arrive(4)

    state = watched.ledger.state
    assert (state.announced, state.settled, state.incomplete) == (4, 4, 2)
    assert state.lost == {INFO: 2, DEPTH: 2, COLOR: 2, POSE: 2}


@pytest.mark.parametrize("number", [2**40, 2**64 - 1])
def test_a_number_far_ahead_is_counted_without_a_list_of_what_lacks(watched, number: int):
    watched.announce(1)
    watched.arrive(1)
    tracemalloc.start()
    watched.ledger.announce(SampleName(1, 2, 2000), number, {DEPTH})
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 4e6
    state = watched.ledger.state
    assert (state.announced, state.incomplete) == (number, number - 2)
    assert state.lost == {INFO: number - 2, DEPTH: number - 2}
    watched.ledger.announce(SampleName(1, 3, 3000), number - 1, {DEPTH})
    assert watched.ledger.state.incomplete == number - 3, "one that is taken late is remembered"


def test_an_announcement_that_a_thread_takes_late_is_not_lost(watched):
    for number in (1, 3, 2):
        watched.announce(number)
        watched.arrive(number)
    state = watched.ledger.state
    assert (state.announced, state.settled, state.incomplete, state.lost) == (3, 3, 0, {})


def test_an_announcement_taken_late_takes_its_place_before_its_successor_s(watched):
    watched.announce(1)
    watched.arrive(1)
    watched.announce(3)
    watched.announce(2)  # by another thread, a moment later

    watched.arrive(2)

    assert watched.ledger.state.last == name(2)
    assert watched.ledger.state.lost == {}
    watched.arrive(3)
    assert watched.ledger.state.last == name(3)
    watched.announce(5)
    watched.arrive(5)
    watched.announce(4)
    watched.arrive(4)
    state = watched.ledger.state
    assert (state.last, state.settled, state.incomplete) == (name(5), 5, 0)


def test_another_bridge_begins_to_count_anew(watched):
    for stamp_ns, sequence in ((10, 7), (20, 1), (30, 2)):
        watched.ledger.announce(SampleName(1, sequence, stamp_ns), sequence, ())
    assert watched.ledger.state.incomplete == 0
    assert watched.ledger.state.announced == 3


@pytest.mark.parametrize("known_first", [True, False])
def test_samples_before_the_first_announcement_are_lost_to_a_reader_that_was_there(
    watched, known_first
):
    """It took the first number that it saw for the beginning."""
    if known_first:
        watched.ledger.expect_from_first()
    watched.announce(3)
    watched.arrive(3)
    if not known_first:
        assert watched.ledger.state.incomplete == 0, "of a reader that came in the middle"
        watched.ledger.expect_from_first()
    state = watched.ledger.state
    assert (state.announced, state.settled, state.incomplete) == (3, 3, 2)
    assert state.lost == {INFO: 2, DEPTH: 2, COLOR: 2, POSE: 2}

    watched.announce(4)
    watched.arrive(4)
    watched.ledger.expect_from_first()
    assert watched.ledger.state.incomplete == 2


def test_the_first_samples_of_the_next_bridge_are_lost_to_a_reader_that_was_there(watched):
    watched.ledger.expect_from_first()
    for stamp_ns, sequence in ((10, 1), (20, 2), (30, 3), (40, 3)):
        watched.ledger.announce(SampleName(1, sequence, stamp_ns), sequence, ())
    assert watched.ledger.state.lost == {INFO: 2}
    assert watched.ledger.state.announced == 6


def test_what_has_come_before_its_announcement_is_known(watched):
    watched.arrive(1, DEPTH, POSE)
    assert watched.ledger.arrivals(name(1).stamp_ns) == {DEPTH, POSE}
    assert watched.ledger.arrivals(name(2).stamp_ns) == set()


def test_the_middleware_s_losses_are_told_beside_ours():
    before = LedgerState(2, 2, 0, {}, None, {POSE: 1})
    state = LedgerState(3, 3, 1, {DEPTH: 1}, name(3), {POSE: 4, COLOR: 2})
    since = state.since(before)
    assert since.lost_by_middleware == {POSE: 3, COLOR: 2}
    assert shortfall(since) == (
        f"1 of 1 samples are incomplete; lost: {DEPTH} 1; "
        f"the middleware lost messages of {COLOR} 2, {POSE} 3"
    )
    alone = LedgerState(3, 3, lost_by_middleware={POSE: 3})
    assert shortfall(alone) == f"the middleware lost messages of {POSE} 3"


def test_a_view_is_waited_for_after_its_messages_but_not_without_what_it_needs(watched):
    watched.announce(1, map_of="map")
    watched.arrive(1)
    watched.now_s = 10 * LOST_AFTER_S
    watched.ledger.expire()
    assert watched.ledger.open == 1, "fusing may take its time"
    assert watched.ledger.wait(0.0) == [name(1)]
    watched.arrive(1, "map")
    assert watched.ledger.wait(0.0) == []

    watched.announce(2, map_of="map")
    watched.arrive(2, COLOR, POSE)
    watched.announce(3, map_of="map")
    watched.arrive(3)
    watched.ledger.give_up(name(3).stamp_ns, "the queue was full")
    assert watched.ledger.open == 0
    assert watched.ledger.state.lost == {DEPTH: 1, "the queue was full": 1}


def test_views_may_get_into_the_map_in_any_order(watched):
    for number in (1, 2):
        watched.announce(number, map_of="map")
        watched.arrive(number)
    watched.arrive(2, "map")
    assert watched.ledger.open == 2
    watched.arrive(1, "map")
    assert (watched.ledger.open, watched.ledger.state.incomplete) == (0, 0)


def test_a_map_that_begins_anew_asks_for_no_older_sample(watched):
    watched.announce(1)
    watched.announce(2)
    watched.ledger.forget(before_ns=name(2).stamp_ns)
    assert watched.ledger.open == 1
    before = watched.ledger.state
    watched.arrive(2, DEPTH, POSE)
    watched.ledger.give_up_all()
    assert watched.ledger.state.since(before).lost == {COLOR: 1}


def test_every_loss_is_counted_exactly_whatever_is_lost(watched):
    """Random losses of messages and announcements that come in any order of topics."""
    rng = np.random.default_rng(0)
    came = rng.random((500, len(TOPICS))) > 0.2
    came[-1] = True
    for number in range(1, len(came) + 1):
        if rng.random() < 0.5:
            watched.announce(number)
        for index in rng.permutation(len(TOPICS)):
            if came[number - 1, index]:
                watched.arrive(number, TOPICS[index])
        if watched.ledger.state.announced < number:
            watched.announce(number)
    state = watched.ledger.state
    assert state.settled == len(came)
    assert state.incomplete == np.count_nonzero(~came.all(axis=1))
    assert state.lost == {t: np.count_nonzero(~came[:, i]) for i, t in enumerate(TOPICS)}


def test_a_bag_keeps_what_it_lacks_as_text():
    losses = BagLosses(300, 12, {DEPTH: 12, POSE: 3}, {POSE: 5}, {DEPTH: 2})
    assert BagLosses.read(losses.entries) == losses
    assert losses.any
    assert losses.sentences == [
        f"12 of 300 samples are incomplete; lost: {DEPTH} 12, {POSE} 3",
        f"the middleware lost messages of {POSE} 5",
        f"the end came before messages of {DEPTH} 2 were written",
    ]
    assert not BagLosses(300).any


def test_gaps_in_the_numbers_of_a_topic_are_counted():
    numbers = MissingNumbers()
    assert [numbers.before(DEPTH, number) for number in (7, 8, 12, 13)] == [0, 0, 3, 0]
    assert numbers.before(POSE, 40) == 0
    assert [numbers.before(DEPTH, number) for number in (1, 2, 4)] == [0, 0, 1]
