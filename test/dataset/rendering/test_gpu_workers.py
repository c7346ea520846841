"""Workers get GPUs of their own from Ray, which only pretends here that the machine has four."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from dataset_runs import contents, render_here, run, write_config
from repository import REPOSITORY
from typer.main import get_command
from waiting import START_PATIENCE_S

from oaisys_core.errors import InvalidInputError
from oaisys_dataset.cli.dataset import dataset_app
from oaisys_dataset.plan import SPLITS
from oaisys_dataset.rendering.ray_session import ray_session
from oaisys_dataset.rendering.ray_settings import RaySettings

CLUSTER = """
import sys
from ray.cluster_utils import Cluster
head = {"num_cpus": 4, "num_gpus": 4, "include_dashboard": False}
cluster = Cluster(initialize_head=True, head_node_args=head)
print(cluster.address, flush=True)
sys.stdin.read()
cluster.shutdown()
"""


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """A cluster of one machine with four cores and, as Ray believes, four GPUs."""
    with tempfile.TemporaryDirectory(prefix="oaisys_gpu_") as folder:
        env = {**os.environ, "RAY_TMPDIR": folder, "RAY_USAGE_STATS_ENABLED": "0"}
        with subprocess.Popen(
            [sys.executable, "-c", CLUSTER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=env,
            text=True,
        ) as cluster:
            assert cluster.stdout is not None
            yield cluster.stdout.readline().strip()
            cluster.communicate(timeout=START_PATIENCE_S)


def tasks(address: str, gpus: float, count: int, pause_s: float = 1.0) -> list[tuple[str, int]]:
    """Return the GPUs that tasks at the same time may use, and their processes."""

    def task() -> tuple[str, int]:
        time.sleep(pause_s)
        return os.environ.get("CUDA_VISIBLE_DEVICES", "all"), os.getpid()

    settings = RaySettings(address, memory_gb=0.1, gpus=gpus)
    with ray_session(settings) as session:
        remote = settings.remote(session.ray, task)
        found = session.ray.get([remote.remote() for _ in range(count)])
    return list(found)


@pytest.mark.long
def test_each_worker_sees_a_gpu_of_its_own(address: str) -> None:
    found = tasks(address, 1.0, 5)
    assert {gpus for gpus, _ in found} == {"0", "1", "2", "3"}
    # A process that had seen one GPU would go on with it, whatever its next task is given.
    assert len({process for _, process in found}) == 5


@pytest.mark.soak
def test_two_workers_share_a_gpu_and_one_gets_two(address: str) -> None:
    assert all(gpus in "0123" for gpus, _ in tasks(address, 0.5, 4, 0.1))
    assert all(len(gpus.split(",")) == 2 for gpus, _ in tasks(address, 2.0, 2, 0.1))


@pytest.mark.long
def test_without_the_option_workers_see_what_the_machine_has(address: str) -> None:
    ((gpus, _),) = tasks(address, 0.0, 1, 0.0)
    assert gpus == os.environ.get("CUDA_VISIBLE_DEVICES", "all")


@pytest.mark.long
@pytest.mark.parametrize(("gpus", "workers"), [(0.0, 4), (1.0, 4), (2.0, 2), (0.5, 4), (4.0, 1)])
def test_as_many_worlds_are_rendered_as_there_are_gpus(
    address: str, gpus: float, workers: int
) -> None:
    with ray_session(RaySettings(address, memory_gb=0.1, gpus=gpus)) as session:
        assert session.workers == workers


@pytest.mark.long
def test_more_gpus_than_a_machine_has_are_wrong_input(address: str) -> None:
    settings = RaySettings(address, memory_gb=0.1, gpus=5)
    with (
        pytest.raises(InvalidInputError, match=r"gpus_per_worker: received 5, expected at most 4"),
        ray_session(settings),
    ):
        pass
    with pytest.raises(InvalidInputError, match="a share of one GPU, or a whole number"):
        RaySettings(gpus=1.5)


@pytest.mark.soak
def test_a_data_set_is_rendered_by_workers_with_gpus(address: str, tmp_path: Path) -> None:
    config, worlds, views = write_config(tmp_path), 3, 1
    options = ("--address", address, "--worlds", worlds, "--views", views)
    with_gpus = run(config, tmp_path / "gpus", *options, "--gpus-per-worker", 1)
    assert with_gpus.returncode == 0, with_gpus.stderr
    render_here(config, tmp_path / "none", SPLITS, worlds, views)
    assert contents(tmp_path / "gpus") == contents(tmp_path / "none")


@pytest.mark.parametrize("name", ["render.sbatch", "rayjob.yaml"])
def test_recipes_give_the_command_options_that_it_has(name: str) -> None:
    text = (REPOSITORY / "examples/clusters" / name).read_text(encoding="utf-8")
    _, _, line = text.rpartition("oaisys dataset render")
    words = line.replace("\\\n", " ").split("\n\n")[0].split("entrypointNumCpus")[0].split()
    options = {word for word in words if word.startswith("--")}
    group: Any = get_command(dataset_app)
    command = group.commands["render"]
    known = {option for parameter in command.params for option in parameter.opts}
    assert {"--resume", "--address", "--gpus-per-worker"} <= options <= known
