"""Whose job is next."""

from __future__ import annotations

from oaisys_grpc.server.jobs.turns import MAX_CONNECTIONS, Turns


def served(turns: Turns, waiting: list[str], count: int) -> list[str]:
    """The connections of the next jobs, where each of the waiting ones always has another job."""
    return [turns.next(waiting) for _ in range(count)]


def test_connections_take_turns() -> None:
    assert served(Turns(), ["a", "b", "c"], 5) == ["a", "b", "c", "a", "b"]


def test_a_known_connection_waits_for_one_of_all_others() -> None:
    turns = Turns()
    turns.note_read("known")
    crowd = [f"new {number}" for number in range(60)]
    order = served(turns, [*crowd, "known"], 20)
    assert order[1::2] == 10 * ["known"] or order[::2] == 10 * ["known"]
    assert len(set(order)) == 11


def test_all_that_do_not_read_share_a_turn() -> None:
    turns = Turns()
    bad = [f"bad {number}" for number in range(60)]
    for name in bad:
        turns.note_unread(name)
    served(turns, bad, 7)
    assert turns.next([*bad, "newcomer"]) == "newcomer"
    turns.note_read("bad 3")  # it has mended its ways
    assert served(turns, [*bad, "newcomer"], 12).count("bad 3") == 4


def test_memory_of_connections_is_bounded() -> None:
    turns = Turns()
    for number in range(3 * MAX_CONNECTIONS):
        turns.note_read(str(number))
    turns.next(["a"])
    assert len(turns._standing) == MAX_CONNECTIONS
    assert len(turns._served) <= 2
