"""Rendering of small data sets as a user does it, with kills, and comparison of what comes out."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import psutil

from oaisys_core.config import load_config
from oaisys_dataset.places import open_place
from oaisys_dataset.plan import parse_splits, world_tasks
from oaisys_dataset.records import VARYING_FIELDS
from oaisys_dataset.rendering.dataset_rendering import dataset_info
from oaisys_dataset.rendering.workers import write_world
from oaisys_dataset.rendering.world_render import WorldRenderer
from oaisys_dataset.shards import HEAD

CONFIG = """
seed: 3
backend: analytic
stage: {surroundings: plain, preset: mounds, extent_m: 30.0, resolution_px: 65}
materials: {texture_size_px: 64, mask: {size_px: 64, relief: 0}}
assets: {rocks: [{kind: angular, count: [2, 9], size_m: [0.3, 1.0]}]}
sensors:
  cameras:
    - name: camera
      width_px: 64
      height_px: 48
      fx_px: 54.0
      fy_px: 54.0
      modalities: [rgb, depth, semantic_0, instance, normal]
  motion: {kind: hover, height_above_ground_m: [3, 6]}
"""
WORLDS, VIEWS = 4, 3
TIMEOUT_S = 400.0
"""After so long a program hangs. On idle cores a run takes seconds, beside others far longer."""


def write_config(folder: Path, text: str = CONFIG) -> Path:
    """Write a configuration of small worlds without Blender, and return its path."""
    path = folder / "config.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def command(config: Path, out: Path | str, *more: object) -> list[str]:
    """Return the command that renders `WORLDS` worlds with `VIEWS` views each."""
    sizes = ("--worlds", WORLDS, "--views", VIEWS, "--memory-per-worker", 0.5)
    words = ("dataset", "render", config, "--out", out, *sizes, *more)
    return [sys.executable, "-m", "oaisys_core", *map(str, words)]


def run(*arguments: Any) -> subprocess.CompletedProcess[str]:
    """Run `command` to its end."""
    line = command(*arguments)
    return subprocess.run(line, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)


def render_here(
    config: Path, out: Path, splits: str, worlds: int = WORLDS, views: int = VIEWS
) -> None:
    """Render the data set in this process, without Ray."""
    chosen, shares = load_config(config), parse_splits(splits)
    place = open_place(out)
    place.write(HEAD, dataset_info(chosen, worlds, views, shares).to_json().encode())
    renderer = WorldRenderer(chosen, "test")
    for task in world_tasks(chosen.seed, worlds, views, shares):
        list(write_world(place, task, renderer.render(task)))
    renderer.close()


class KilledRun(NamedTuple):
    """How a command ended of which a part was to be killed.

    Attributes:
        is_killed: Whether it was; False if the command had ended before.
        exit_code: Its exit code.
        errors: Its standard error.
        output: Its standard output.
    """

    is_killed: bool
    exit_code: int
    errors: str
    output: str


def run_with_kill(
    line: list[str], victim: str, after_s: float, when: Callable[[], bool] = lambda: True
) -> KilledRun:
    """Run a command, and kill -9 a part of it at a moment.

    Args:
        line: The command.
        victim: ``worker``, ``driver`` or ``node``: Ray's raylet, and its workers, which could
            finish all worlds before the driver hears of it.
        after_s: The moment; the next one at which there is such a process.
        when: Returns whether the moment has come.
    """
    is_killed = False
    driver = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    time.sleep(after_s)
    deadline_s = time.monotonic() + TIMEOUT_S
    while driver.poll() is None and time.monotonic() < deadline_s:
        found = [driver.pid] if victim == "driver" else _processes(driver.pid, victim)
        if found and when():
            dying = [found[0], *(_processes(driver.pid, "worker") if victim == "node" else [])]
            for process in dying:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(process, signal.SIGKILL)
            is_killed = True
            break
        time.sleep(0.01)
    output, errors = driver.communicate(timeout=TIMEOUT_S)
    return KilledRun(is_killed, driver.returncode, errors, output)


def _processes(driver: int, kind: str) -> list[int]:
    """Return the ids of the workers or of the raylet below a driver."""
    found = []
    try:
        below = psutil.Process(driver).children(recursive=True)
    except psutil.NoSuchProcess:
        return []
    for process in below:
        try:
            title = " ".join(process.cmdline()[:1])
        except psutil.Error:
            continue
        if (kind == "worker" and "render_world" in title) or (
            kind == "node" and title.endswith("raylet/raylet")
        ):
            found.append(process.pid)
    return found


def contents(folder: Path) -> dict[str, Any]:
    """Return what must be equal in two data sets, by file: all but workers and seconds."""
    found: dict[str, Any] = {}
    for path in sorted(folder.rglob("*")):
        if path.is_dir():
            continue
        name = str(path.relative_to(folder))
        found[name] = _lines(path) if path.suffix == ".jsonl" else path.read_bytes()
    return found


def _lines(path: Path) -> list[dict[str, Any]]:
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [{k: v for k, v in line.items() if k not in VARYING_FIELDS} for line in lines]
