"""Where worlds are rendered, by how many workers, and for how many there is room."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oaisys_core.errors import InvalidInputError

MEMORY_PER_WORKER_GB = 2.5
"""Memory reserved by default; Blender took up to 1.5 GB in worlds of 20,000 objects."""

USED_SHARE = 0.85
"""Share of the available memory that embedded workers may take together."""

ROUNDING = 1e-6
"""Of shares of a GPU, such as three times 0.333334."""


@dataclass(frozen=True)
class RaySettings:
    """Where worlds are rendered, and by how many workers.

    Attributes:
        address: ``HOST:PORT`` of a cluster; None for an embedded Ray.
        workers: Number of worlds that are rendered at a time; None for as many as fit.
        memory_gb: Memory that is reserved for each worker.
        retries: How often a world is rendered again after its worker or node died.
        gpus: GPUs of each worker; a share of one is shared, and 0 asks for none, so that workers
            see all GPUs of their machine.
    """

    address: str | None = None
    workers: int | None = None
    memory_gb: float = MEMORY_PER_WORKER_GB
    retries: int = 3
    gpus: float = 0.0

    def __post_init__(self) -> None:
        if self.gpus < 0 or (self.gpus > 1 and self.gpus != int(self.gpus)):
            expected = "a share of one GPU, or a whole number of them"
            raise InvalidInputError("gpus_per_worker", self.gpus, expected)

    @property
    def memory_bytes(self) -> int:
        """Memory that is reserved for each worker."""
        return int(self.memory_gb * 1e9)

    def remote(self, ray: Any, function: Callable[..., Any]) -> Any:
        """Return a function of Ray whose tasks get what a worker needs.

        Ray shows a task its GPUs alone, by ``CUDA_VISIBLE_DEVICES`` and the like. A process keeps
        those that it has seen first, so with GPUs each task gets a process of its own.
        """
        gpus: dict[str, Any] = {"num_gpus": self.gpus, "max_calls": 1} if self.gpus else {}
        asked = {"num_cpus": 1, "memory": self.memory_bytes, "max_retries": self.retries}
        return ray.remote(**asked, **gpus)(function)


def worker_count(settings: RaySettings) -> int:
    """Return how many workers an embedded Ray has: what was asked for, or one for each core.

    There are fewer where their memory would not suffice.

    Raises:
        InvalidInputError: Not even one fits.
    """
    usable = USED_SHARE * available_bytes()
    if settings.memory_bytes > usable:
        expected = f"at most {usable / 1e9:.1f}, which this machine has"
        raise InvalidInputError("memory_per_worker", settings.memory_gb, expected)
    if settings.workers is not None:
        return settings.workers
    return max(1, min(len(os.sched_getaffinity(0)), int(usable // settings.memory_bytes)))


def available_bytes() -> int:
    """Return the memory that this process and its children may still take."""
    lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    found = [int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable")]
    group = Path("/sys/fs/cgroup")
    try:
        limit, used = ((group / f"memory.{name}").read_text() for name in ("max", "current"))
        found.append(int(limit) - int(used))
    except (OSError, ValueError):
        pass  # there is no group, or it has no limit
    return max(0, min(found))


def worker_slots(ray: Any, settings: RaySettings) -> int:
    """Return how many workers the nodes have room for, with one core and their GPUs each."""
    total = 0
    for found in _resources(ray):
        slots = [found.get("CPU", 0), found.get("memory", 0) // settings.memory_bytes]
        if settings.gpus:
            slots.append(found.get("GPU", 0) / settings.gpus + ROUNDING)
        total += int(min(slots))
    return total


def check_gpus(ray: Any, settings: RaySettings) -> None:
    """Raise unless a node has the GPUs of a worker: Ray would wait for them for ever."""
    if not settings.gpus:
        return
    most = max((found.get("GPU", 0) for found in _resources(ray)), default=0)
    if settings.gpus > most:
        expected = f"at most {most:g}, which Ray finds on the machine that has most"
        raise InvalidInputError("gpus_per_worker", settings.gpus, expected)


def _resources(ray: Any) -> list[dict[str, float]]:
    return [node["Resources"] for node in ray.nodes() if node["Alive"]]
