"""Planners of another package that fail each in its way, installed for a test's processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NoReturn

from oaisys_core.types import Pose
from oaisys_mapping.exploration.planner import Planner, Situation
from oaisys_mapping.exploration.planners import RandomPlanner


class Stuck(Planner):
    """Never answers, whatever is raised in it, and has started a program."""

    name = "stuck"

    def next_pose(self, situation: Situation) -> NoReturn:
        subprocess.Popen(["sleep", "1000"])
        while True:
            try:
                time.sleep(1000)
            except BaseException:  # noqa: BLE001
                continue


class Crashing(Planner):
    """Ends its process as a fault in native code does."""

    name = "crashing"

    def next_pose(self, situation: Situation) -> Pose | None:
        os.kill(os.getpid(), signal.SIGSEGV)
        return None


class Leaving(Planner):
    """Ends the program that it takes itself for."""

    name = "leaving"

    def next_pose(self, situation: Situation) -> NoReturn:
        sys.exit(0)


class Wordless(Planner):
    """Raises what cannot say what it is."""

    name = "wordless"

    class Error(BaseException):
        """An error whose text is one, too."""

        def __str__(self) -> str:
            raise RuntimeError("no text")

    def next_pose(self, situation: Situation) -> NoReturn:
        raise self.Error


class Unmade(Planner):
    """Cannot be made."""

    name = "unmade"

    def __init__(self) -> None:
        raise RuntimeError("weights.pt is missing")

    def next_pose(self, situation: Situation) -> Pose | None:
        return None


def start_daemons() -> None:
    """Leave a fork and a program, each in a session of its own; the fork keeps all files open."""
    subprocess.Popen(["sleep", "1000"], start_new_session=True)
    if not os.fork():
        os.setsid()
        time.sleep(1000)
        os._exit(0)


class DaemonAndStuck(Planner):
    """Leaves daemons, and never answers."""

    name = "daemon_stuck"

    def next_pose(self, situation: Situation) -> NoReturn:
        start_daemons()
        while True:
            time.sleep(1000)


class DaemonAndGone(Planner):
    """Leaves daemons, and ends its process."""

    name = "daemon_gone"

    def next_pose(self, situation: Situation) -> NoReturn:
        start_daemons()
        os._exit(3)


class Deaf(Planner):
    """Ignores signals and stops its group."""

    name = "deaf"

    def next_pose(self, situation: Situation) -> NoReturn:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        os.kill(0, signal.SIGSTOP)
        raise RuntimeError("goes on")


class Closing(Planner):
    """Closes all files, its connection too."""

    name = "closing"

    def next_pose(self, situation: Situation) -> NoReturn:
        os.closerange(0, 200)
        while True:
            time.sleep(1000)


class Sending(Planner):
    """Writes to its connection what is no answer, as a library may to a descriptor."""

    name = "sending"
    text = b"\x00\x00\x00\x05hello\n"

    def next_pose(self, situation: Situation) -> NoReturn:
        os.write(int(sys.argv[1]), self.text)
        while True:
            time.sleep(1000)


class SendingOther(Sending):
    """Sends JSON that is no answer."""

    name = "sending_other"
    text = b'{"position_m": [0, 0, NaN], "quat_xyzw": [0, 0, 0, 1], "path_m": [[0, 0, 0]]}\n'


class SendingNested(Sending):
    """Sends brackets in which a parser's stack ends."""

    name = "sending_nested"
    text = b"[" * 100_000 + b"\n"


class SendingPickle(Sending):
    """Sends a pickle that runs a function where it is read."""

    name = "sending_pickle"
    text = b"cbuiltins\nexit\n(I7\ntR."


class Beginning(Sending):
    """Sends the header of a long message, and no more."""

    name = "beginning"
    text = b"\xff\xff\xff\xff" + (2**40).to_bytes(8, "big")


class Flooding(Planner):
    """Never ends to send."""

    name = "flooding"

    def next_pose(self, situation: Situation) -> NoReturn:
        while True:
            os.write(int(sys.argv[1]), b"x" * (1 << 20))


class Working(RandomPlanner):
    """Does what `RandomPlanner` does."""

    name = "working"


HANGING = (DaemonAndStuck, Deaf, Beginning)
SENDING = (Sending, SendingOther, SendingNested, SendingPickle)
KINDS = (
    *(Stuck, Crashing, Leaving, Wordless, Unmade, Working),
    *(*HANGING, *SENDING, DaemonAndGone, Closing, Flooding),
)


def install_planners(folder: Path) -> dict[str, str]:
    """Return the variables with which a process finds all of them, by their names."""
    package = folder / "foreign_planners-1.dist-info"
    package.mkdir(parents=True)
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign-planners\nVersion: 1\n")
    lines = [f"{kind.name} = {__name__}:{kind.__name__}\n" for kind in KINDS]
    (package / "entry_points.txt").write_text("".join(("[oaisys.planners]\n", *lines)))
    folders = (str(folder), str(Path(__file__).parent), os.environ.get("PYTHONPATH", ""))
    return {"PYTHONPATH": os.pathsep.join(filter(None, folders))}
