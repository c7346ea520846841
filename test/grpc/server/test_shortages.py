"""Too little memory, too few files: a sentence at the start, another way or a sentence later."""

from __future__ import annotations

import errno
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest
from served_simulator import FLAT_WORLD, Server
from waiting import PATIENCE_S

from oaisys_core.geometry import pose_looking_down
from oaisys_core.system.shortages import shortage
from oaisys_grpc.server.jobs.job import MAX_SAMPLES, RECENT_S

NADIR = pose_looking_down(1, 2, 7)
CAMERA = {"width_px": 320, "height_px": 240, "fx_px": 270.0, "fy_px": 270.0}
LARGER_WORLD = {**FLAT_WORLD, "sensors": {"cameras": [CAMERA]}}
"""Its images are large enough to be shared."""


@pytest.mark.parametrize(
    ("limit", "number", "said"),
    [
        ("RLIMIT_NOFILE", 64, "this process may open 64 files, and a server needs 128: ulimit -n"),
        ("RLIMIT_NOFILE", 12, "files"),
        ("RLIMIT_AS", 300_000_000, "ulimit -v"),
    ],
)
def test_a_server_without_room_says_so_and_does_not_start(
    tmp_path: Path, limit: str, number: int, said: str
) -> None:
    begin = (
        f"import resource, os, sys; resource.setrlimit(resource.{limit}, ({number}, {number})); "
        "os.execv(sys.executable, [sys.executable, '-m', 'oaisys_grpc', 'serve', "
        "'--backend', 'analytic', '--address', '127.0.0.1:0'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", begin],
        check=False,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        cwd=tmp_path,
    )
    assert done.returncode == 1, done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""


def test_images_go_another_way_where_no_memory_can_be_shared(
    start_server: Callable[..., Server],
) -> None:
    server = start_server(LARGER_WORLD)
    with server.client() as client:
        client.step_batch()
        client.render_sample(NADIR)
        worker = server.worker()
        before = worker.num_fds()
        for limit, few in ((resource.RLIMIT_FSIZE, 1000), (resource.RLIMIT_NOFILE, 3)):
            allowed = worker.rlimit(limit)
            worker.rlimit(limit, (few, allowed[1]))
            for number in range(3):
                sample = client.render_sample(pose_looking_down(number, 2, 7 + limit))
                np.testing.assert_allclose(sample.frame("camera", "depth").data, 7 + limit, 1e-5)
            worker.rlimit(limit, allowed)
            sample = client.render_sample(pose_looking_down(5, 2, 7 + limit))
            np.testing.assert_allclose(sample.frame("camera", "depth").data, 7 + limit, 1e-5)
        assert server.worker().pid == worker.pid
        assert worker.num_fds() <= before + 2


@pytest.mark.long
def test_descriptors_come_back(start_server: Callable[..., Server]) -> None:
    """Views, clients and refused connections leave none behind."""
    server = start_server(LARGER_WORLD)
    process = psutil.Process(server.process.pid)

    def settled() -> tuple[int, int]:
        """Return what both processes have open where no more samples are kept than always are."""
        time.sleep(RECENT_S)
        client.render_sample(NADIR)
        return process.num_fds(), server.worker().num_fds()

    with server.client() as client:
        client.step_batch()
        for number in range(MAX_SAMPLES):
            client.render_sample(pose_looking_down(0.1 * number, 2, 7))
        before = settled()
        for number in range(20):
            client.render_sample(pose_looking_down(0.1 * number, 1, 7))
            with server.client() as other:
                other.info()
        assert max(np.subtract(settled(), before)) <= 2


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "no memory left"),
        (OSError(errno.ENOSPC, "No space left on device", "/dev/shm/x"), "/dev/shm"),
        (OSError(errno.EMFILE, "Too many open files"), "ulimit -n"),
        (RuntimeError("can't start new thread"), "threads"),
        (OSError("libtbb.so.12: failed to map segment from shared object"), "ulimit -v"),
        (RuntimeError("[Open3D Error] Embree error: Out of Memory"), "ulimit -v"),
        (RuntimeError("CPU malloc failed: size 1024"), "ulimit -v"),
        (ImportError("libx.so: failed to map segment from shared object"), "ulimit -v"),
    ],
)
def test_a_shortage_is_a_sentence(error: Exception, said: str) -> None:
    wrapped = RuntimeError("something else")
    wrapped.__cause__ = error
    for each in (error, wrapped):
        assert said in str(shortage(each))
    assert shortage(ValueError("a fault of ours")) is None
    assert shortage(OSError(errno.ENOENT, "no such file")) is None


def test_little_address_space_is_told_before_libraries_are_imported(tmp_path: Path) -> None:
    """OpenBLAS asked for memory again and again, for ever, while SciPy was imported."""
    begin = (
        f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({600_000 * 1024},) * 2); "
        "from oaisys_core.cli.program import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", begin, "render", "--out", "x"],
        check=False,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        cwd=tmp_path,
    )
    assert done.returncode == 1
    assert done.stderr == (
        "oaisys: this process may have 614400000 bytes of address space, and it needs 700000000:"
        " ulimit -v\n"
    )
