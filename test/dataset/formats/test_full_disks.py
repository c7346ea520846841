"""Exports to a disk on which not all of them fits: one sentence, nothing left."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from oaisys_dataset import Dataset

COMMAND = [sys.executable, "-P", "-B", "-m", "oaisys_core", "dataset", "export"]


def limit_files(size: int) -> None:
    """Let no file of this process become larger, as a disk that is full does."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


@pytest.mark.parametrize("size", [1_000, 8_000, 100_000])
def test_a_full_disk_is_a_sentence_and_leaves_no_hdf5(
    scanned: Dataset, tmp_path: Path, size: int
) -> None:
    out = tmp_path / "out"
    done = subprocess.run(
        [*COMMAND, scanned.place.url, "--format", "hdf5", "--out", str(out)],
        preexec_fn=lambda: limit_files(size),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr == f"oaisys: {out}: could not be written: File too large\n"
    assert list(tmp_path.iterdir()) == []
