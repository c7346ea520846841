"""A server that cannot end in time exits, and leaves nothing."""

import subprocess
import sys

from waiting import START_PATIENCE_S

HANGING = """
import threading
from concurrent.futures import Future
from oaisys_grpc.server import end_request

end_request._LAST_S = 0.2
end_request.exit_at_last(Future(), CLEAN_UP)
threading.Event().wait()
"""


def run_hanging(clean_up: str) -> subprocess.CompletedProcess[str]:
    """Run a program that never ends by itself, with what it does at last."""
    return subprocess.run(
        [sys.executable, "-c", HANGING.replace("CLEAN_UP", clean_up)],
        capture_output=True,
        text=True,
        timeout=START_PATIENCE_S,
        check=False,
    )


def test_a_program_that_hangs_in_its_end_cleans_up_and_exits() -> None:
    ended = run_hanging("lambda: print('cleaned', flush=True)")
    assert (ended.returncode, ended.stdout) == (0, "cleaned\n")
    assert "something did not end within 0.2 s" in ended.stderr


def test_it_exits_even_if_it_cannot_clean_up() -> None:
    assert run_hanging("lambda: 1 / 0").returncode == 0
