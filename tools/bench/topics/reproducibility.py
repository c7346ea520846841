"""Reproducibility: whether a request gives the same picture in every process."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from oaisys_core.system.ending.owner import command_with_owner
from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings, say_of_part

PROCESSES_PER_RUN = 6
MAX_BUSY = 2
"""Busy loops beside every third process, which changes the order in which threads work."""


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return, by quality, how many pictures differ from the most frequent one."""
    count = PROCESSES_PER_RUN * settings.runs
    digests: dict[str, Counter[str]] = {}
    for index in range(count):
        tell = say_of_part(say, index, count, f"process {index + 1} of {count}")
        with _busy(index % (MAX_BUSY + 1)):
            found: dict[str, list[str]] = run_job("reproducibility.pictures", settings, tell)
        for quality, those in found.items():
            digests.setdefault(quality, Counter()).update(those)
    return [
        figure(
            f"different_pictures_{quality}",
            "",
            [those.total() - those.most_common(1)[0][1]],
            Goal(0),
            f"of {those.total()} of one request in {count} processes; files in pictures/",
        )
        for quality, those in digests.items()
    ]


@contextmanager
def _busy(count: int) -> Iterator[None]:
    """Run so many endless loops beside the block."""
    with ExitStack() as loops:
        for _ in range(count):
            command = command_with_owner([sys.executable, "-c", "while True: pass"])
            loop = loops.enter_context(subprocess.Popen(command))
            loops.callback(loop.kill)
        yield
