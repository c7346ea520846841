"""A mesh or volume is whole under its name, whenever its writer is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from waiting import PATIENCE_S, wait_until

from oaisys_core.files.whole_files import whole_file
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.mesh_io import read_ply, write_ply

WRITE_AGAIN_AND_AGAIN = """
import sys
from pathlib import Path
import numpy as np
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.mesh_io import write_ply
n = 400_000
corners = np.random.default_rng(0).random((n, 3))
mesh = ColoredMesh(corners, np.arange(n - n % 3, dtype=np.int32).reshape(-1, 3),
                   np.zeros((n, 3), np.uint8))
while True:
    write_ply(Path(sys.argv[1]), mesh)
"""


def small_mesh() -> ColoredMesh:
    return ColoredMesh(np.eye(3), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8))


def test_a_mapper_killed_while_it_saves_leaves_no_half_mesh(tmp_path: Path) -> None:
    """The mesh was written under its own name: half of it was there."""
    path = tmp_path / "mesh.ply"
    for number in range(4):
        write_ply(path, small_mesh())
        writer = subprocess.Popen([sys.executable, "-c", WRITE_AGAIN_AND_AGAIN, str(path)])
        wait_until(lambda: path.stat().st_size > 1000, process=writer)
        time.sleep(0.026 * number)  # another moment each time
        writer.send_signal(signal.SIGKILL)
        writer.wait(PATIENCE_S)
        assert len(read_ply(path).triangles) == 133_333


def write_half(path: Path) -> None:
    with whole_file(path) as partial:
        partial.write_bytes(b"half")
        raise RuntimeError


def test_what_fails_leaves_the_file_that_was_there(tmp_path: Path) -> None:
    path = tmp_path / "mesh.ply"
    write_ply(path, small_mesh())
    with pytest.raises(RuntimeError):
        write_half(path)
    assert len(read_ply(path).triangles) == 1
    assert list(tmp_path.iterdir()) == [path]


def test_no_mesh_replaces_a_device_or_a_pipe(tmp_path: Path) -> None:
    pipe = tmp_path / "mesh.ply"
    os.mkfifo(pipe)
    with pytest.raises(OSError, match="no regular file"):
        write_ply(pipe, small_mesh())
    assert pipe.is_fifo()
    assert list(tmp_path.iterdir()) == [pipe]
