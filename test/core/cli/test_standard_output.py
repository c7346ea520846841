"""What a program prints while it renders is its own."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import ctypes, threading
from oaisys_core.config import config_from_mapping
from oaisys_core.simulation import Simulation

simulation = Simulation(config_from_mapping({
    "stage": {"surroundings": "plain", "extent_m": 16, "resolution_px": 33},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 32}},
    "assets": {"rocks": []},
    "sensors": {"cameras": [{"width_px": 32, "height_px": 24}]},
    "render": {"quality": "preview"},
}))
simulation.step_batch()
done = threading.Event()
printed = []

def chat():
    while not done.wait(0.005):
        print("own", len(printed))
        printed.append(1)

thread = threading.Thread(target=chat)
thread.start()
simulation.step_sample()
done.set()
thread.join()
simulation.close()
ctypes.CDLL(None).puts(b"from C")
ctypes.CDLL(None).fflush(None)
print("end", len(printed))
"""


@pytest.mark.blender
def test_rendering_in_one_s_own_process_prints_nothing_and_drops_no_print() -> None:
    result = subprocess.run(
        [sys.executable, "-u", "-c", PROGRAM],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    lines = result.stdout.splitlines()
    own = [line for line in lines if line.startswith("own ")]
    assert own == [f"own {index}" for index in range(len(own))]
    assert [line for line in lines if line not in own] == ["from C", f"end {len(own)}"]
