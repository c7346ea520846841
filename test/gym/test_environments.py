"""The gym's environments: gymnasium's own checks, seeds, rewards, errors, and the process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import psutil
import pytest
from gymnasium.utils.env_checker import check_env
from waiting import START_PATIENCE_S, wait_until

import oaisys_gym  # noqa: F401 - registers the environments
from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_gym import simulator
from oaisys_gym.simulator import EpisodeSimulator

TASKS = ("NextBestView", "Coverage", "DriveToGoal")


@pytest.fixture
def address(own: EpisodeSimulator) -> str:
    return own.address


@pytest.mark.filterwarnings("ignore:.*render modes.*")
@pytest.mark.parametrize("task", TASKS)
def test_gymnasium_finds_nothing_wrong(task: str, address: str) -> None:
    environment = gymnasium.make(
        f"oaisys/{task}-v0", address=address, world_seeds=(3,), render_mode="rgb_array"
    )
    check_env(environment.unwrapped, skip_render_check=True)
    picture = environment.unwrapped.render()
    assert isinstance(picture, np.ndarray)
    assert picture.shape == (48, 64, 3)
    assert len(np.unique(picture)) > 20
    environment.close()


def test_images_come_by_modality_and_depth_ends_at_the_range(address: str) -> None:
    modalities = ("rgb", "depth", "semantic_0", "instance")
    environment = gymnasium.make(
        "oaisys/DriveToGoal-v0",
        address=address,
        modalities=modalities,
        max_range_m=6.0,
        world_seeds=(3,),
    )
    observation, info = environment.reset(seed=1)
    assert info["world_seed"] == 3
    assert environment.observation_space.contains(observation)
    assert observation["depth"].max() == 6.0
    assert 0.5 < observation["depth"].min() < 6.0
    environment.close()


@pytest.mark.parametrize("task", TASKS)
def test_the_seed_of_an_episode_decides_on_all_that_is_drawn(
    task: str, faulty: EpisodeSimulator
) -> None:
    """Faults and redrawn light went on from one episode to the next, and from world to world."""
    environment = gymnasium.make(
        f"oaisys/{task}-v0",
        address=faulty.address,
        modalities=("depth", "rgb"),
        world_seeds=(3,),
        disable_env_checker=True,
    )

    def episode(seed: int) -> list[dict[str, np.ndarray]]:
        seen = [environment.reset(seed=seed)[0]]
        environment.action_space.seed(1)
        seen += [environment.step(environment.action_space.sample())[0] for _ in range(2)]
        return [*seen, environment.reset()[0]]

    first, other, again = episode(7), episode(8), episode(7)
    for before, after in zip(first, again, strict=True):
        for name, values in before.items():
            np.testing.assert_array_equal(values, after[name], err_msg=name)
        assert environment.observation_space.contains(before)
    assert not np.array_equal(first[0]["rgb"], first[1]["rgb"])
    assert not np.array_equal(first[0]["depth"], other[0]["depth"])
    environment.close()


def test_depth_is_0_where_a_sensor_measured_nothing(faulty: EpisodeSimulator) -> None:
    """NaN of missing pixels and -inf of those too near left the space or were clipped to 0 m."""
    environment = gymnasium.make(
        "oaisys/DriveToGoal-v0", address=faulty.address, world_seeds=(3,), max_range_m=6.0
    )
    observation, _ = environment.reset(seed=7)
    depth_m = observation["depth"]
    inner: Any = environment.unwrapped
    measured_m = inner._images["depth"]
    assert np.isnan(measured_m).mean() == pytest.approx(0.3, abs=0.03)
    assert np.isneginf(measured_m).any()
    np.testing.assert_array_equal(depth_m == 0, np.isnan(measured_m) | np.isneginf(measured_m))
    assert depth_m[depth_m > 0].min() >= 4.0
    assert depth_m.max() == 6.0
    assert environment.observation_space.contains(observation)
    environment.close()


def test_the_rover_drives_the_distance_of_its_speed(address: str) -> None:
    environment = gymnasium.make("oaisys/DriveToGoal-v0", address=address, world_seeds=(3,))
    environment.reset(seed=2)
    inner: Any = environment.unwrapped
    before = np.array(inner.pose.position_m)
    _, reward, _, _, info = environment.step(np.array((0.5, 0.0), np.float32))
    after = np.array(inner.pose.position_m)
    assert not info["blocked"]
    assert np.hypot(*(after - before)[:2]) == pytest.approx(0.5, abs=1e-6)
    goal_m = inner._goal_m
    nearer_m = np.linalg.norm(goal_m - before[:2]) - np.linalg.norm(goal_m - after[:2])
    assert reward == pytest.approx(nearer_m - 0.05, abs=1e-6)
    environment.close()


def test_a_rover_stops_at_the_stages_edge(address: str) -> None:
    environment = gymnasium.make("oaisys/DriveToGoal-v0", address=address, world_seeds=(3,))
    environment.reset(seed=2)
    inner: Any = environment.unwrapped
    for _ in range(60):
        observation, _, _, _, info = environment.step(np.array((1.0, 0.0), np.float32))
        if info["blocked"]:
            break
    assert info["blocked"]
    assert observation["blocked"] == [1]
    assert (np.abs(inner.pose.position_m[:2]) <= 12).all()
    environment.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"modalities": ("thermal",)}, "modalities: received 'thermal'"),
        ({"modalities": ("normal",)}, "modalities: received 'normal'"),
        ({"max_range_m": -1.0}, "max_range_m: received -1.0"),
        ({"render_mode": "human"}, "render_mode: received 'human'"),
        ({"world_seeds": (-1,)}, "world_seeds: received -1"),
        ({"world_seeds": (True,)}, "world_seeds: received True"),
        ({"world_seeds": 5}, "world_seeds: received 5"),
        ({"max_range_m": "x"}, "max_range_m: received 'x'"),
        ({"max_range_m": None}, "max_range_m: received None"),
        ({"max_range_m": True}, "max_range_m: received True"),
        ({"max_range_m": 1e300}, r"max_range_m: received 1e\+300"),
        ({"modalities": None}, "modalities: received None"),
        ({"modalities": "depth"}, "modalities: received 'depth'"),
        ({"modalities": (3,)}, "modalities: received 3"),
    ],
)
def test_wrong_arguments_are_refused_by_name(
    options: dict[str, Any], message: str, address: str
) -> None:
    from oaisys_gym.coverage import Coverage

    with pytest.raises(InvalidInputError, match=message):
        Coverage(address=address, **options)


def test_wrong_actions_and_options_are_refused(address: str) -> None:
    environment = gymnasium.make(
        "oaisys/Coverage-v0", address=address, world_seeds=(3,), disable_env_checker=True
    )
    environment.reset(seed=1)
    with pytest.raises(InvalidInputError, match="2 finite numbers"):
        environment.step(np.array((np.nan, 0), np.float32))
    with pytest.raises(InvalidInputError, match="options: received 'world'"):
        environment.reset(options={"world": 3})
    with pytest.raises(InvalidInputError, match="options: received 5"):
        environment.reset(options=5)  # type: ignore[arg-type]
    environment.close()


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ("", "config: received ''"),
        (5, "config: received 5"),
        ({"stage": {"extent_m": {1, 2}}}, r"config\.stage\.extent_m: received \{1, 2\}"),
        ({"seed": [1, object()]}, r"config\.seed\.1: received <object"),
        ({"seed": np.ma.array(3, mask=True)}, r"config\.seed: received masked"),
    ],
)
def test_what_is_no_configuration_is_refused_by_name(config: Any, message: str) -> None:
    """Empty text was the default worlds."""
    with pytest.raises(InvalidInputError, match=message):
        EpisodeSimulator(config, "")


@pytest.mark.parametrize("name", ["NextBestView", "Coverage", "DriveToGoal"])
def test_what_is_no_action_is_refused_and_the_episode_goes_on(name: str, address: str) -> None:
    environment = gymnasium.make(
        f"oaisys/{name}-v0", address=address, world_seeds=(3,), disable_env_checker=True
    ).unwrapped
    size = environment.action_space.shape or ()
    with pytest.raises(gymnasium.error.ResetNeeded):
        environment.step(np.zeros(size, np.float32))
    environment.reset(seed=1)
    ragged = [1, [2]]
    infinite, imaginary = np.full(size, np.inf), np.full(size, 1j)
    masked = np.ma.array(np.zeros(size), mask=True)
    partly = np.ma.array(np.zeros(size), mask=[True] + [False] * (size[0] - 1))
    none: tuple[Any, ...] = (ragged, infinite, "x", None, imaginary, np.zeros(7), -1)
    none += (masked, partly, np.ma.masked)
    for action in none:
        with pytest.raises(InvalidInputError, match="action: received"):
            environment.step(action)
    beyond, *_ = environment.step(np.full(size, 1e30))
    assert environment.observation_space.contains(beyond)
    environment.close()
    environment.close()
    with pytest.raises(OaisysError, match="closed"):
        environment.reset()


def test_a_forked_process_is_told_to_spawn(monkeypatch: pytest.MonkeyPatch, address: str) -> None:
    monkeypatch.setattr(simulator, "_IMPORTED_IN", 1)
    with pytest.raises(OaisysError, match='context="spawn"'):
        EpisodeSimulator(None, address)


FORK = """
import os, sys, numpy as np
from oaisys_gym.coverage import Coverage
environment = Coverage(address=sys.argv[1])
environment.reset(seed=1)
for end in (sys.exit, lambda: (environment.close(), sys.exit())):
    child = os.fork()
    if not child:
        end()
    os.waitpid(child, 0)
environment.step(np.zeros(2))
print("goes on", os.path.dirname(environment._simulator.address.removeprefix("unix:")), flush=True)
"""


def run_in_own_process(code: str, folder: Path) -> subprocess.Popen[str]:
    """Start a program with an environment of its own, which is the first argument's address."""
    return subprocess.Popen(
        [sys.executable, "-c", code, ""],
        env={**os.environ, "TMPDIR": str(folder)},
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.mark.usefixtures("no_process_left")
def test_a_fork_ends_nothing_of_its_parents_who_removed_what_a_dead_program_had_left(
    tmp_path: Path,
) -> None:
    """Python's end in the fork ended the parent's simulator, and removed its folder."""
    code = "from oaisys_core.system.owned_folders import OwnedFolder; import os; "
    code += "OwnedFolder('oaisys-gym-'); os._exit(0)"
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    other = tmp_path / "oaisys-gym-other"
    other.mkdir()
    assert len(list(tmp_path.iterdir())) == 2
    with run_in_own_process(FORK, tmp_path) as program:
        said, _ = program.communicate(timeout=START_PATIENCE_S)
    assert said.startswith(f"goes on {tmp_path}")
    assert list(tmp_path.glob("oaisys-gym-*")) == [other]


@pytest.mark.usefixtures("no_process_left")
@pytest.mark.parametrize(
    "number",
    [
        signal.SIGKILL,
        pytest.param(signal.SIGTERM, marks=pytest.mark.soak),
        pytest.param(signal.SIGHUP, marks=pytest.mark.soak),
    ],
)
def test_a_killed_program_leaves_no_folder(number: signal.Signals, tmp_path: Path) -> None:
    begin, _, _ = FORK.partition("for end")
    code = f"{begin}\nprint(flush=True)\nimport time; time.sleep(1000)"
    with run_in_own_process(code, tmp_path) as program:
        assert program.stdout is not None
        program.stdout.readline()
        assert list(tmp_path.glob("oaisys-gym-*"))
        program.send_signal(number)
    wait_until(
        lambda: not list(tmp_path.glob("oaisys-gym-*")),
        explain=lambda: {
            str(path): path.read_text("utf-8")[-2000:] if path.is_file() else ""
            for path in tmp_path.rglob("*")
        },
    )


@pytest.mark.long
def test_a_configuration_that_is_wrong_is_quoted(tmp_path: Path) -> None:
    file = tmp_path / "worlds.yaml"
    file.write_text("stage: {preset: moundz}\n", encoding="utf-8")
    with pytest.raises(OaisysError, match="moundz"):
        EpisodeSimulator(file, "")


def processes_of(simulator: EpisodeSimulator) -> list[psutil.Process]:
    """Return the processes that were started in the simulator's folder."""
    folder = str(Path(simulator.address.removeprefix("unix:")).parent)
    children = psutil.Process().children(recursive=True)
    servers = [child for child in children if folder in " ".join(child.cmdline())]
    return [*servers, *(each for server in servers for each in server.children(recursive=True))]


def test_the_simulator_ends_with_its_environment(own: EpisodeSimulator) -> None:
    """The last test of this file: it ends the simulator of all."""
    started = processes_of(own)
    assert len(started) >= 2  # server and worker
    environment = gymnasium.make("oaisys/Coverage-v0", address=own.address)
    environment.close()
    assert all(process.is_running() for process in started)  # it is somebody else's
    own.close()
    wait_until(lambda: not any(process.is_running() for process in started))
    assert not Path(own.address.removeprefix("unix:")).parent.exists()
