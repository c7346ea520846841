"""Files of odometry programs: where they cannot be written, a program fails, not the drive."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE_S

from oaisys_mapping.odometry.programs import ProgramError, program_folder

FULL = 'mount -t tmpfs -o size=4k tmpfs "$0" && export TMPDIR="$0" && exec "$@"'
PRIVATE = ["unshare", "--mount", "--propagation", "private"]
CODE = """
import numpy as np
from oaisys_mapping.odometry.inertial import preintegrate
from oaisys_mapping.odometry.programs import ProgramError
from oaisys_mapping.odometry.trajectories import TimedTransforms
times_s = np.arange(1000.0)
truth = TimedTransforms(times_s, np.tile(np.eye(4), (1000, 1, 1)))
try:
    preintegrate(np.zeros((1000, 7)), truth, np.zeros((1000, 6)), np.eye(4), 9.81)
except ProgramError as error:
    print(error)
"""


def test_a_folder_that_cannot_be_made_is_the_program_s_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "missing"))
    with pytest.raises(ProgramError, match="No such file or directory"), program_folder():
        pass


def write_to_full_disk() -> None:
    with program_folder() as folder:
        file = folder / "imu.npz"
        file.symlink_to("/dev/full")
        file.write_bytes(b"measurements")


def test_a_full_disk_is_the_program_s_failure() -> None:
    with pytest.raises(ProgramError, match=r"temporary files .*No space left on device"):
        write_to_full_disk()


def test_a_full_folder_for_temporary_files_is_a_sentence(tmp_path: Path) -> None:
    pytest.importorskip("gtsam", exc_type=ModuleNotFoundError)
    if subprocess.run([*PRIVATE, "true"], capture_output=True, check=False).returncode:
        pytest.skip("this user must not mount a file system")
    done = subprocess.run(
        [*PRIVATE, "sh", "-c", FULL, str(tmp_path), sys.executable, "-P", "-c", CODE],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.stdout.startswith("its temporary files could not be written (No space left"), done
    assert "Traceback" not in done.stderr
