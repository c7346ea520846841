"""Draws worlds, renders them in processes of their own, and says what is wrong with them.

    python test/helpers/judge_worlds.py --first 1 --worlds 500 --out DIR

Exit code 1 where there is a fault. ``DIR/world_SEED.yaml`` is a world with a fault; ``oaisys render
--config`` renders it alone. ``DIR/verdicts.jsonl`` has the figures of all.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import psutil

VERDICT = "VERDICT "
PER_PROCESS = 20
"""Worlds of one process, so that a crash costs no more."""
BUSY_LIMIT_S = 300
"""Processor seconds for one world: a longer one is a fault. Load does not count."""
STILL_LIMIT_S = 120
"""Seconds in which a process must use some processor time: one that does not hangs."""


def say(text: str) -> None:
    """Print a line at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def child(seeds: list[int], folder: Path, backend: str) -> None:
    """Judge worlds in this process, and print a line of JSON for each."""
    if backend == "blender":
        import bpy  # noqa: F401 - comes before anything that loads Open3D
    from drawn_worlds import drawn_world
    from world_judge import judge

    for seed in seeds:
        began_s = time.monotonic()
        verdict = asdict(judge(drawn_world(seed, folder, backend)))
        line = {"seed": seed, "seconds": round(time.monotonic() - began_s, 2), **verdict}
        say(VERDICT + json.dumps(line))


def watch(process: subprocess.Popen[str], answered: threading.Event) -> None:
    """Kill a process that works too long on an answer, or that stopped working."""
    began_s = before_s = busy_s(process)
    while not answered.wait(STILL_LIMIT_S):
        now_s = busy_s(process)
        if now_s - began_s > BUSY_LIMIT_S or now_s == before_s:
            process.kill()
            return
        before_s = now_s


def busy_s(process: subprocess.Popen[str]) -> float:
    """Return the processor seconds of a process; 0 once it has ended."""
    try:
        used = psutil.Process(process.pid).cpu_times()
    except psutil.NoSuchProcess:
        return 0.0
    return float(used.user + used.system)


def verdicts_of(seeds: list[int], folder: Path, backend: str) -> Iterator[dict[str, Any]]:
    """Judge worlds in new processes; a crash, or a world that hangs, is a fault of that world."""
    while seeds:
        command = [sys.executable, __file__, "--files", str(folder), "--backend", backend]
        command += ["--child", *map(str, seeds)]
        with tempfile.TemporaryFile("w+", errors="replace") as errors:
            process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True)
            assert process.stdout is not None
            while seeds:
                answered = threading.Event()
                threading.Thread(target=watch, args=(process, answered), daemon=True).start()
                line = process.stdout.readline()
                answered.set()
                if not line:
                    break
                if line.startswith(VERDICT):
                    seeds = seeds[1:]
                    yield json.loads(line.removeprefix(VERDICT))
            code = process.wait()
            errors.seek(0)
            how = f"the process ended with {code} (killed if it took {BUSY_LIMIT_S} s or hung)"
            if seeds:
                fault = f"{how}: {errors.read()[-1000:]}"
                yield {"seed": seeds[0], "seconds": 0.0, "faults": [fault], "figures": []}
                seeds = seeds[1:]


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--worlds", type=int, default=50)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--backend", default="blender", choices=("blender", "analytic"))
    parser.add_argument("--files", type=Path)
    parser.add_argument("--child", type=int, nargs="*")
    arguments = parser.parse_args()
    if arguments.child is not None:
        child(arguments.child, arguments.files, arguments.backend)
        return 0
    return run(arguments.out, arguments.first, arguments.worlds, arguments.backend)


def run(out: Path, first: int, count: int, backend: str) -> int:
    """Judge worlds of consecutive seeds, and print those with faults."""
    import yaml
    from drawn_worlds import drawn_world, make_files

    make_files(out / "files")
    bad = 0
    for begin in range(first, first + count, PER_PROCESS):
        seeds = list(range(begin, min(begin + PER_PROCESS, first + count)))
        for verdict in verdicts_of(seeds, out / "files", backend):
            with (out / "verdicts.jsonl").open("a", encoding="utf-8") as file:
                file.write(json.dumps(verdict) + "\n")
            if not verdict["faults"]:
                continue
            bad += 1
            path = out / f"world_{verdict['seed']}.yaml"
            world = drawn_world(verdict["seed"], out / "files", backend)
            path.write_text(yaml.safe_dump(world, sort_keys=False), encoding="utf-8")
            say(f"seed {verdict['seed']}: oaisys render --config {path} --out out")
            say("\n".join(f"    {fault}" for fault in verdict["faults"]))
        say(f"{seeds[-1] - first + 1} of {count} worlds, {bad} with faults")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
