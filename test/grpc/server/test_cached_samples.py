"""The server's cache of views: marked answers, new ids, none where it is switched off."""

from __future__ import annotations

from collections.abc import Callable

import psutil
import pytest
from served_simulator import FLAT_WORLD, Server
from waiting import PATIENCE_S, wait_until

from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import ModuleMetadata, Sample

StartServer = Callable[..., Server]
POSES = [pose_looking_down(x, 1.0, 5.0) for x in (0.0, 1.0)]


def images(sample: Sample) -> list[bytes]:
    return [frame.data.tobytes() for frame in sample.frames]


@pytest.mark.long
def test_a_view_that_comes_again_has_the_same_bytes_and_a_new_id(start_server: StartServer) -> None:
    server = start_server(FLAT_WORLD)
    with server.client() as client:
        client.step_batch()
        first, _, again = (client.render_sample(POSES[i]) for i in (0, 1, 0))
        changed = client.render_sample(POSES[0], metadata=ModuleMetadata(render={"exposure_ev": 1}))
        assert (first.from_cache, again.from_cache, changed.from_cache) == (False, True, False)
        assert again.sample_id == 3
        assert images(again) == images(first) != images(changed)
        assert client.get_sample(1, 3).from_cache
        worker = server.worker()
        worker.kill()
        psutil.wait_procs([worker], PATIENCE_S)
        wait_until(lambda: server.worker().pid != worker.pid)
        client.wait_ready(PATIENCE_S)
        after = client.render_sample(
            POSES[0], metadata=ModuleMetadata(render={"exposure_ev": 0}), modalities=["depth"]
        )
    assert (after.sample_id, after.from_cache) == (5, False)
    assert after.frames[0].data.tobytes() == again.frame("camera", "depth").data.tobytes()


@pytest.mark.long
def test_it_can_be_switched_off(start_server: StartServer) -> None:
    with start_server(FLAT_WORLD, "--pose-cache-mb", "0").client() as client:
        client.step_batch()
        assert not any(client.render_sample(POSES[0]).from_cache for _ in range(3))
