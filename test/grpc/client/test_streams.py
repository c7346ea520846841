"""Calls that bring several messages: however they end, the client lets go of them."""

from __future__ import annotations

import contextlib
import gc
import threading
from collections.abc import Callable
from itertools import count

import pytest
from served_simulator import Server
from waiting import wait_until

from oaisys_core.errors import CancelledError, NotFoundError, OaisysError
from oaisys_core.geometry import pose_looking_down
from oaisys_grpc.client.simulator_client import SimulatorClient

ROUNDS = 5


def calls_kept() -> int:
    """How many calls grpcio holds on to."""
    gc.collect()
    return sum(type(thing).__name__ == "_CallState" for thing in gc.get_objects())


def use_to_the_end(client: SimulatorClient, height_m: float) -> None:
    sample = client.render_sample(pose_looking_down(0.0, 0.0, height_m))
    client.get_sample(sample.batch_id, sample.sample_id)
    client.ground_truth_mesh()
    assert list(client.watch_operation(client.start_sample()))


def leave(client: SimulatorClient, height_m: float) -> None:
    with client.stream_sample(pose_looking_down(0.0, 0.0, height_m)) as stream:
        for _ in stream:
            break
    for _ in client.watch_operation(client.start_sample()):
        break


def cancel(client: SimulatorClient, height_m: float) -> None:
    with client.stream_sample(pose_looking_down(0.0, 0.0, height_m)) as stream:
        stream.cancel()
        with pytest.raises(CancelledError):
            stream.read()


def leave_while_another_thread_reads(client: SimulatorClient, height_m: float) -> None:
    with client.stream_sample(pose_looking_down(0.0, 0.0, height_m)) as stream:

        def read() -> None:
            with contextlib.suppress(OaisysError):
                stream.read()

        reader = threading.Thread(target=read)
        reader.start()
    reader.join()


def fail(client: SimulatorClient, _height_m: float) -> None:
    with pytest.raises(NotFoundError):
        client.get_sample(1, 10**6)


HEIGHTS_M = (3.0 + 0.01 * number for number in count())
"""Each but once: a view that comes again is not rendered."""


@pytest.mark.long
@pytest.mark.parametrize(
    "use", [use_to_the_end, leave, cancel, leave_while_another_thread_reads, fail]
)
def test_no_call_stays_however_it_ended(
    stepped_flat_server: Server, use: Callable[[SimulatorClient, float], None]
) -> None:
    before = calls_kept()
    with stepped_flat_server.client() as client:
        with client.stream_sample(pose_looking_down(0.0, 0.0, next(HEIGHTS_M))) as stream:
            assert calls_kept() > before  # it would be seen
            stream.read()
        for _ in range(ROUNDS):
            use(client, next(HEIGHTS_M))
        # Threads of gRPC let go of a cancelled call when they wake up.
        wait_until(lambda: calls_kept() - before < ROUNDS)
