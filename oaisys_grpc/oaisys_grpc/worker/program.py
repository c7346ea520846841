"""The process that runs the simulation: ``python -m oaisys_grpc.worker``, started by the server.

Blender belongs on a process's main thread and may crash, hang or grow. So it runs here, connected
to the server by a socket pair, and ends with it. Must not import gRPC.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import faulthandler
import json
import logging
import os
import queue
import resource
import signal
import socket
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

from oaisys_core.errors import OaisysError, RenderError
from oaisys_core.files.path_fields import confine_paths
from oaisys_core.simulation import Simulation
from oaisys_core.system.ending.interruption import interruptible
from oaisys_core.system.shortages import shortage
from oaisys_core.types import SimulatorInfo
from oaisys_grpc.contract.faults import fault_from_error
from oaisys_grpc.contract.world_messages import info_to_proto
from oaisys_grpc.worker.calls import CallContext, Reply, SimulationCalls
from oaisys_grpc.worker.protocol import Connection, WorkerMessage

_LOG = logging.getLogger(__name__)
_PR_SET_PDEATHSIG = 1
_MAX_FILES = 4096
_OUT_OF_MEMORY_SCORE = 500
"""Half of the machine's memory on top of its own, where the kernel chooses what to kill."""


class Worker:
    """Answers one call after the other on the main thread; a second thread listens for cancels."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._queue: queue.SimpleQueue[WorkerMessage] = queue.SimpleQueue()
        self._cancelled: set[int] = set()
        self._calls = SimulationCalls()
        self._sent_info: SimulatorInfo | None = None

    def run(self) -> None:
        """Work until told to end."""
        threading.Thread(target=self._listen, name="listener", daemon=True).start()
        while (call := self._queue.get()).type != "end":
            self._answer(call)
        if self._calls.simulation is not None:
            self._calls.simulation.close()

    def _listen(self) -> None:
        """Receive messages while the main thread works; end the process with the server."""
        while True:
            try:
                message = self._connection.receive()
            except EOFError:
                os._exit(0)  # the main thread may be deep inside Blender
            if message.type == "cancel":
                self._cancelled.add(message.head["id"])
            else:
                self._queue.put(message)

    def _answer(self, call: WorkerMessage) -> None:
        number, method = call.head["id"], call.head["method"]
        head: dict[str, Any] = {"type": "answer", "id": number}
        context = CallContext(self._connection, number, self._cancelled)
        reply = Reply()
        try:
            with confine_paths(self._calls.roots), interruptible(context.stop_if_cancelled):
                reply = self._calls.answer(call, context)
        except OaisysError as error:
            head["fault"] = vars(fault_from_error(error))
        except Exception as error:  # noqa: BLE001 - whatever failed is the caller's to know
            _LOG.exception("%s failed", method)
            failure = shortage(error) or RenderError(
                f"{method} failed: {type(error).__name__}: {error}"
            )
            head["fault"] = vars(fault_from_error(failure))
        self._cancelled.discard(number)
        if self._calls.simulation is not None:
            head |= self._world(self._calls.simulation, number)
        self._connection.send(head, *reply)

    def _world(self, simulation: Simulation, call: int) -> dict[str, Any]:
        """Return the state that another worker would go on from; send the info if it changed."""
        info = simulation.info()
        lasting = replace(info, batch_id=0, sample_id=0, rig_pose=None)
        if self._sent_info is None or _differs(lasting, self._sent_info):
            self._sent_info = lasting
            content = info_to_proto(lasting).SerializeToString()
            self._connection.send({"type": "info", "id": call}, content)
        state = json.dumps(simulation.state())
        pose = None if info.rig_pose is None else vars(info.rig_pose)
        ids = {"batch_id": info.batch_id, "sample_id": info.sample_id}
        return {**ids, "rig_pose": pose, "state": state}


def _differs(info: SimulatorInfo, sent: SimulatorInfo) -> bool:
    """Return whether they may differ."""
    if info.sensors is not sent.sensors:  # they hold arrays
        return True
    return replace(info, sensors=()) != replace(sent, sensors=())


def die_with_parent(parent_pid: int) -> None:
    """Have the kernel kill this process when its server ends, however that ends."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0):
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    if os.getppid() != parent_pid:
        os._exit(0)


def limit_worker() -> None:
    """Limit this process, so that its failure does not become the machine's.

    There are no core files, because Blender's are gigabytes. The number of open files is limited,
    so that a leak of them ends the worker alone. Where memory is short, the kernel kills the worker
    before its server. The server watches the memory itself: Blender and Embree reserve far more
    addresses than they use, which a limit of the kernel's would count.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    files = _MAX_FILES if hard == resource.RLIM_INFINITY else min(_MAX_FILES, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (files, files))
    with contextlib.suppress(OSError):  # a container may forbid it
        Path("/proc/self/oom_score_adj").write_text(str(_OUT_OF_MEMORY_SCORE), encoding="ascii")


def main() -> int:
    """Run a worker on the inherited descriptor."""
    parser = argparse.ArgumentParser(prog="oaisys_grpc.worker.program")
    parser.add_argument("--fd", type=int, required=True)
    parser.add_argument("--parent", type=int, required=True)
    options = parser.parse_args()
    die_with_parent(options.parent)
    limit_worker()
    # The traceback of a crash goes to the log, and from there into the error.
    faulthandler.enable(all_threads=False)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the server's to handle
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")
    Worker(Connection(socket.socket(fileno=options.fd))).run()
    return 0
