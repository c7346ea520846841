"""A process that a library ends leaves one sentence, and the library's own messages in a file."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import START_PATIENCE_S

PROGRAM = """
import logging, os, sys, tempfile
from oaisys_core.system.own_streams import keep_messages
from oaisys_core.system.ending.signals import work_in_child

tempfile.tempdir, how = sys.argv[1:]
logging.basicConfig(format="%(message)s")
work_in_child("try")
with keep_messages("library_", "gone, see {log}"):
    os.write(2, b"noise of a library\\n")
    os.write(1, b"more of it\\n")
    print("result")
    print("shown", file=sys.stderr)
    logging.warning("logged")
    if how == "exit":
        os._exit(7)
    if how == "kill":
        os.kill(os.getpid(), 9)
print("after", file=sys.stderr)
logging.warning("logged after")
os.write(2, b"own again\\n")
print("result after")
"""

ENDS = {
    "exit": (1, "shown\nlogged\noaisys try: gone, see {log}\n", True),
    "kill": (1, "shown\nlogged\noaisys try: its process was ended by SIGKILL\n", False),
    "return": (0, "shown\nlogged\nafter\nlogged after\nown again\n", False),
}


@pytest.mark.parametrize("how", ENDS)
def test_what_is_said_and_what_is_left(how: str, tmp_path: Path) -> None:
    code, said, is_kept = ENDS[how]
    line = [sys.executable, "-c", PROGRAM, str(tmp_path), how]
    ended = subprocess.run(
        line, capture_output=True, text=True, timeout=START_PATIENCE_S, check=False
    )
    logs = list(tmp_path.iterdir())
    assert len(logs) == is_kept
    log = logs[0] if logs else None
    assert (ended.returncode, ended.stderr) == (code, said.format(log=log))
    assert ended.stdout == "result\n" + ("result after\n" if how == "return" else "")
    if log is not None:
        assert log.read_text(encoding="utf-8") == "noise of a library\nmore of it\n"


@pytest.mark.parametrize("name", [b"\xfe\xfe", b"a\nb"])
def test_a_folder_of_any_name_is_told(name: bytes, tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(name)
    folder.mkdir()
    line = [sys.executable, "-c", PROGRAM, str(folder), "exit"]
    ended = subprocess.run(line, capture_output=True, timeout=START_PATIENCE_S, check=False)
    (log,) = folder.iterdir()
    assert ended.returncode == 1
    assert log.read_text(encoding="utf-8") == "noise of a library\nmore of it\n"
    assert log.name.encode() in ended.stderr
    assert b"Traceback" not in ended.stderr
