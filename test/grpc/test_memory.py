"""Memory of one sample serves the next."""

from __future__ import annotations

import subprocess
import sys

import pytest

ROUNDS = """
import resource, sys, threading
from oaisys_grpc.memory import keep_freed_memory

SIZES = [921_600, 1_228_800, 614_400, 1_228_800, 4_915_200] * 3  # a sample's messages, copied

if sys.argv[1] == "kept":
    keep_freed_memory()
found = []

def publish():
    for _ in range(20):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        blocks = [bytearray(b"x") * size for size in SIZES]
        del blocks
        found.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)

thread = threading.Thread(target=publish)
thread.start()
thread.join()
print(max(found[5:]))
"""


def most_page_faults(how: str) -> int:
    """Return the most page faults that a round of allocations took, after the first ones."""
    done = subprocess.run(
        [sys.executable, "-c", ROUNDS, how], capture_output=True, text=True, check=True, timeout=60
    )
    return int(done.stdout)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc only")
def test_buffers_of_a_sample_are_used_again() -> None:
    assert most_page_faults("kept") < 100
    assert most_page_faults("by default") > 1000
