"""Segments of shared memory, which other users must not open."""

from __future__ import annotations

import gc
from pathlib import Path

import numpy as np

from oaisys_grpc.contract.shared_memory import copy_to_segment


def test_segments_are_their_users_alone() -> None:
    descriptors = Path("/proc/self/fd")
    before = set(descriptors.iterdir())
    copies = copy_to_segment([np.arange(5)])
    found = set(descriptors.iterdir()) - before
    segments = [path for path in found if path.is_symlink() and "memfd" in str(path.readlink())]
    assert segments
    assert {path.stat().st_mode & 0o777 for path in segments} == {0o600}
    del copies
    gc.collect()
