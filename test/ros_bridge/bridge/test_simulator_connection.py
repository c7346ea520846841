"""The bridge's connection while its simulator loses a worker, before anybody has looked again."""

import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from served_simulator import FLAT_WORLD, Server
from waiting import PATIENCE_S, wait_until

from oaisys_core.errors import OaisysError, WorkerLostError
from oaisys_ros_bridge.bridge.requests import ViewRequest
from oaisys_ros_bridge.bridge.simulator_link import SimulatorLink

pytestmark = pytest.mark.ros


@pytest.mark.usefixtures("leaks")
def test_a_request_after_the_loss_of_a_worker_waits_for_the_next_one(tmp_path: Path) -> None:
    fault = f"crash-once:{tmp_path / 'crashed'}"
    test_build = {"OAISYS_TEST_BUILD": "1", "OAISYS_FAULT": fault}
    with Server(tmp_path / "server", FLAT_WORLD, **test_build) as server:
        link = SimulatorLink(
            server.address, initial_batch=True, timeout_s=PATIENCE_S, on_change=lambda: None
        )
        check_lost_worker(link)
        link.close()


def check_lost_worker(link: SimulatorLink) -> None:
    """Lose the worker, and ask before anybody has looked."""
    link.check()
    with pytest.raises(WorkerLostError), link.sample_stream(None, ViewRequest(None), None) as lost:
        list(lost)
    with ThreadPoolExecutor(1) as pool:
        has_begun = threading.Event()

        def go_on() -> bool:
            has_begun.set()
            return False

        waiting = pool.submit(link.wait_for_worker, go_on)
        wait_until(lambda: has_begun.is_set() or waiting.done())
        assert has_begun.is_set()
        wait_until(lambda: is_found(link))
        waiting.result()
    assert link.state.ready
    with link.sample_stream(None, ViewRequest(None), None) as stream:
        assert list(stream)


def is_found(link: SimulatorLink) -> bool:
    """Look for the simulator as the link's own thread does."""
    try:
        link.check()
    except OaisysError as error:
        link.lose(error)
        return False
    return link.state.ready
