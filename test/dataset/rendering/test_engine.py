"""Data sets rendered on Ray: whole, and the same on any workers, after kills and full disks."""

import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil
import pytest
from dataset_runs import (
    CONFIG,
    TIMEOUT_S,
    VIEWS,
    WORLDS,
    command,
    contents,
    render_here,
    run,
    run_with_kill,
    write_config,
)
from waiting import wait_until

from oaisys_core.cli.repeat import MIN_PSNR_DB
from oaisys_dataset.reader import open_dataset
from oaisys_dataset.repeat import repeat_records

SPLITS = "train=0.6,val=0.4"
MORE = ("--splits", SPLITS, "--num-workers", 2)

VICTIMS = ("driver", "node", "worker")
CHAINS = int(os.environ.get("DATASET_KILL_CHAINS", "1"))
"""How often the tests kill each of `VICTIMS`, at random moments."""

BLENDER = CONFIG.replace(
    "backend: analytic",
    """backend: blender
render: {quality: preview}
""",
)
BLENDER_WORLDS = 3


@pytest.fixture
def temporary_folder(monkeypatch) -> Iterator[Path]:
    """The folder of temporary files of a test's programs, with a path short enough for Ray."""
    with tempfile.TemporaryDirectory(prefix="oaisys_test_") as folder:
        monkeypatch.setenv("TMPDIR", folder)
        yield Path(folder)


class UndisturbedRun(NamedTuple):
    """A data set that two workers of Ray rendered without disturbance.

    Attributes:
        config: Its configuration.
        folder: Where it is.
        ended: How the command ended.
        took_s: Its time in seconds.
    """

    config: Path
    folder: Path
    ended: subprocess.CompletedProcess[str]
    took_s: float


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[UndisturbedRun]:
    """Without Blender; not to be changed."""
    yield from undisturbed_run(tmp_path_factory.mktemp("undisturbed"), CONFIG, WORLDS)


@pytest.fixture(scope="module")
def undisturbed_blender(tmp_path_factory: pytest.TempPathFactory) -> Iterator[UndisturbedRun]:
    """With Blender; not to be changed."""
    yield from undisturbed_run(tmp_path_factory.mktemp("blender"), BLENDER, BLENDER_WORLDS)


def undisturbed_run(folder: Path, text: str, worlds: int) -> Iterator[UndisturbedRun]:
    """Render, with a home and a folder of temporary files below which nothing may be left."""
    config = write_config(folder, text)
    with (
        tempfile.TemporaryDirectory(prefix="oaisys_test_") as temporary,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setenv("TMPDIR", temporary)
        patch.setenv("HOME", temporary)
        begun_s = time.monotonic()
        ended = run(config, folder / "set", *MORE, "--worlds", worlds)
        took_s = time.monotonic() - begun_s
        assert ended.returncode == 0, ended.stderr
        assert not list(Path(temporary).glob("oaisys_ray_*"))
        assert not Path(temporary, ".ray").exists()
    yield UndisturbedRun(config, folder / "set", ended, took_s)


@pytest.mark.long
def test_two_workers_make_the_data_set_that_one_process_makes(
    tmp_path: Path, undisturbed: UndisturbedRun
):
    assert f"{WORLDS} of {WORLDS} worlds are finished" in undisturbed.ended.stdout
    assert "gravel" in undisturbed.ended.stdout  # the balance of the classes
    render_here(undisturbed.config, tmp_path / "here", SPLITS)
    assert contents(undisturbed.folder) == contents(tmp_path / "here")

    dataset = open_dataset(undisturbed.folder)
    assert {record.worker for record in dataset.records}.isdisjoint({"test"})
    assert dataset.splits == ("train", "val")
    ((frame, comparisons),) = repeat_records(dataset, ["000002_0001_camera"], 40.0)
    assert frame == "000002_0001_camera"
    assert {c.name.modality: c.different_px for c in comparisons} == dict.fromkeys(
        ("rgb", "depth", "semantic_0", "instance", "normal"), 0
    )


@pytest.mark.soak
@pytest.mark.parametrize("chain", range(CHAINS))
def test_a_run_that_is_killed_again_and_again_ends_in_the_same_data_set(
    tmp_path: Path, temporary_folder: Path, undisturbed: UndisturbedRun, chain: int, leaks
):
    told = killed_and_resumed(undisturbed, tmp_path / "set", WORLDS, shuffled(VICTIMS))
    assert contents(tmp_path / "set") == contents(undisturbed.folder), told
    wait_until(lambda: not list(temporary_folder.glob("oaisys_ray_*")))


def killed_and_resumed(
    undisturbed: UndisturbedRun, out: Path, worlds: int, victims: Sequence[str]
) -> list[str]:
    """Kill a part of each run at a random moment, resume, and return what was killed when."""
    told = []
    more = (*MORE, "--worlds", worlds, "--resume")
    for victim in victims:
        after_s = random.uniform(0.2, 1.0) * undisturbed.took_s
        ended = run_with_kill(command(undisturbed.config, out, *more), victim, after_s)
        told.append(f"{victim} after {after_s:.2f} s: {ended}")
        if victim == "worker":
            assert ended.exit_code == 0, told  # Ray renders its world again
    if ended.exit_code:
        resumed = run(undisturbed.config, out, *more)
        assert resumed.returncode == 0, (told, resumed.stderr)
    return told


def shuffled(names: Sequence[str]) -> list[str]:
    return random.sample(names, len(names))


@pytest.mark.long
def test_runs_that_a_full_disk_and_the_death_of_ray_s_daemon_end_are_resumed(
    tmp_path: Path, temporary_folder: Path, undisturbed: UndisturbedRun, leaks
):
    config, out = undisturbed.config, tmp_path / "set"
    check_full_disk(config, out)
    assert not [path for path in tmp_path.rglob("*") if ".part" in path.name]
    check_death_of_daemon(config, out)
    resumed = run(config, out, *MORE, "--resume")
    assert resumed.returncode == 0, resumed.stderr
    assert contents(out) == contents(undisturbed.folder)


def check_full_disk(config: Path, out: Path) -> None:
    """It is one sentence with the file's name, and what was finished is whole."""
    program = f"""
import resource, sys
from pathlib import Path
from oaisys_core.cli.repeat import MIN_PSNR_DB
from oaisys_core.config import load_config
from oaisys_dataset.places import open_place
from oaisys_dataset.plan import parse_splits
from oaisys_dataset.rendering.ray_settings import RaySettings
from oaisys_dataset.rendering.dataset_rendering import DatasetRendering, dataset_info
from oaisys_dataset.rendering.workers import ViewCounts
from oaisys_core.errors import RenderError
config = load_config(Path({str(config)!r}))
info = dataset_info(config, {WORLDS}, {VIEWS}, parse_splits({SPLITS!r}))
rendering = DatasetRendering(open_place({str(out)!r}), config, info)
try:
    with rendering.begin(is_resumed=False):
        for event in rendering.run(RaySettings(workers=1, memory_gb=0.5)):
            if rendering.summary.finished == 1:
                # As if the disk had no room for a second shard.
                resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
except RenderError as error:
    print(error)
    sys.exit(7)
"""
    ended = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert ended.returncode == 7, ended.stderr
    assert "world_000001.tar: could not be written: File too large" in ended.stdout
    assert open_dataset(out).worlds == (0,)


def check_death_of_daemon(config: Path, out: Path) -> None:
    """It is said in a sentence, without a line of Ray's."""
    line = command(config, out, *MORE, "--resume")
    ended = run_with_kill(line, "node", 0.0, lambda: len(list(out.glob("shards/*.tar"))) > 1)
    assert (ended.is_killed, ended.exit_code) == (True, 1), ended.errors
    assert "--resume renders the" in ended.errors
    noise = re.compile(r"^\[\d{4}-|Traceback|core_worker|raylet_client|\.cc:", re.MULTILINE)
    assert not noise.search(ended.errors), ended.errors
    assert not noise.search(ended.output), ended.output


@pytest.mark.long
def test_worlds_that_cannot_be_made_are_skipped_and_counted(tmp_path: Path, leaks):
    # Only some of the worlds have so many rocks.
    motion = (
        "{kind: around_target, target_instance: 6, distance_m: [4, 5], elevation_deg: [50, 60]}"
    )
    text = CONFIG.replace("{kind: hover, height_above_ground_m: [3, 6]}", motion)
    ended = run(write_config(tmp_path, text), tmp_path / "set", "--num-workers", 1)
    assert ended.returncode == 1
    dataset = open_dataset(tmp_path / "set")
    assert dataset.worlds
    assert dataset.failures
    assert len(dataset.worlds) + len(dataset.failures) == WORLDS
    assert f"{len(dataset.failures)} of {WORLDS} worlds could not be made" in ended.stderr
    for failure in dataset.failures:
        assert "target_instance" in failure.reason
        assert f"world {failure.world} failed: {failure.reason}" in ended.stderr


@pytest.mark.soak
def test_a_node_of_a_cluster_dies_and_nothing_is_lost(
    tmp_path: Path, undisturbed: UndisturbedRun, leaks, monkeypatch
):
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    config = undisturbed.config
    program = """
import sys
from ray.cluster_utils import Cluster
head = {"num_cpus": 1, "include_dashboard": False}
cluster = Cluster(initialize_head=True, head_node_args=head)
second = cluster.add_node(num_cpus=1)
print(cluster.address, second.all_processes["raylet"][0].process.pid, flush=True)
sys.stdin.read()
cluster.shutdown()
"""
    folder = Path(tempfile.mkdtemp(prefix="oaisys_cluster_"))
    (folder / "ray").mkdir()
    monkeypatch.setenv("RAY_TMPDIR", str(folder))
    cluster = subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert cluster.stdout is not None
        address, raylet = cluster.stdout.readline().split()
        line = [*command(config, tmp_path / "set", "--splits", SPLITS, "--address", address)]
        driver = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        deadline_s = time.monotonic() + TIMEOUT_S
        while not list((tmp_path / "set" / "shards").glob("*.jsonl")):
            assert driver.poll() is None, "it ended early"
            assert time.monotonic() < deadline_s
            time.sleep(0.02)
        psutil.Process(int(raylet)).kill()
        output, _ = driver.communicate(timeout=TIMEOUT_S)
        assert driver.returncode == 0, output
    finally:
        cluster.communicate(timeout=TIMEOUT_S)
        shutil.rmtree(folder)
    assert contents(tmp_path / "set") == contents(undisturbed.folder)


@pytest.mark.long
@pytest.mark.blender
def test_blender_lives_in_the_workers_of_ray(undisturbed_blender: UndisturbedRun):
    dataset = open_dataset(undisturbed_blender.folder)
    assert dataset.worlds == tuple(range(BLENDER_WORLDS))
    assert len({record.worker for record in dataset.records}) == 2
    frames = ["000000_0002_camera", f"{BLENDER_WORLDS - 1:06d}_0001_camera"]
    for _, comparisons in repeat_records(dataset, frames, 40.0):
        assert all(comparison.is_equal for comparison in comparisons)


@pytest.mark.soak
@pytest.mark.blender
@pytest.mark.parametrize("chain", range(CHAINS))
def test_kills_of_blender_s_workers_and_driver_lose_and_change_no_frame(
    tmp_path: Path,
    temporary_folder: Path,
    undisturbed_blender: UndisturbedRun,
    chain: int,
    leaks,
):
    victims = [random.choice(VICTIMS)] if CHAINS == 1 else shuffled(VICTIMS)
    told = killed_and_resumed(undisturbed_blender, tmp_path / "set", BLENDER_WORLDS, victims)
    expected, found = open_dataset(undisturbed_blender.folder), open_dataset(tmp_path / "set")
    assert len(found) == len(expected) == BLENDER_WORLDS * VIEWS, told
    for old, new in zip(expected, found, strict=True):
        assert new.record.frame_id == old.record.frame_id
        for name in ("T_map_camera", "intrinsics", "provenance", "label_pixels", "split"):
            assert getattr(new.record, name) == getattr(old.record, name), name
        for modality, pixels in old.arrays.items():
            if modality == "rgb":
                error = np.mean((pixels.astype(float) - new.arrays["rgb"]) ** 2)
                assert error <= 255**2 / 10 ** (MIN_PSNR_DB / 10), told
            else:
                assert np.array_equal(new.arrays[modality], pixels), (modality, told)
    wait_until(lambda: not list(temporary_folder.glob("oaisys_ray_*")))
