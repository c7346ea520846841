"""The server: owns the port, the queue and the worker; never imports Blender."""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import grpc
from grpc_health.v1 import health, health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection

from oaisys_core.config import SimulationConfig
from oaisys_core.config.sections.sensing.sensors import PosePolicy
from oaisys_core.errors import OaisysError
from oaisys_core.system.ending.signals import end_service_at_signals
from oaisys_core.system.owned_folders import remove_abandoned, remove_if_abandoned
from oaisys_grpc.addresses import (
    UNIX,
    grpc_target,
    host_and_port,
    private_socket,
    remove_socket,
    unix_path,
)
from oaisys_grpc.contract.request_bounds import MAX_REQUEST_BYTES
from oaisys_grpc.legacy.files import LegacyFiles
from oaisys_grpc.legacy.servicer import LEGACY_SERVICE, LegacyServicer
from oaisys_grpc.pb.legacy import oaisys_pb2_grpc
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2, simulator_pb2_grpc
from oaisys_grpc.server.end_request import EndRequest, exit_at_last
from oaisys_grpc.server.jobs.queue import OperationQueue
from oaisys_grpc.server.limits.call_threads import CROWD, CallThreads
from oaisys_grpc.server.limits.connections import connection_options
from oaisys_grpc.server.limits.grpc_log import GrpcLogLimit
from oaisys_grpc.server.limits.guarded_calls import GuardedCalls
from oaisys_grpc.server.limits.open_calls import OpenCalls
from oaisys_grpc.server.limits.slots import THREADS
from oaisys_grpc.server.options import ServerOptions
from oaisys_grpc.server.servicer import SimulatorServicer, send_reason
from oaisys_grpc.server.supervision.supervisor import Supervisor
from oaisys_grpc.server.supervision.worker_process import FOLDER_PREFIX

_LOG = logging.getLogger(__name__)

SERVICE = simulator_pb2.DESCRIPTOR.services_by_name["SimulatorService"].full_name
HEALTH_NAMES = ("", SERVICE, LEGACY_SERVICE)
"""Services whose health is reported; "" is the server as a whole."""

_STOP_S = 1.0
_WORKER_END_S = 0.8
_CALLS_END_S = 0.5
"""For calls to notice that they were cancelled."""
_OWNER_END_S = 10.0
"""For the last threads of a killed program to end, which hold the lock of its folder."""


class HealthWithReason(health.HealthServicer):
    """gRPC's health service; ``Check`` also sends the reason why nothing is served.

    Attributes:
        why_not: Returns the reason; None if the simulator serves.
    """

    def __init__(self) -> None:
        # A client that does not read must not block the thread that reports a change.
        super().__init__(experimental_non_blocking=False)
        self.why_not: Callable[[], OaisysError | None] = lambda: None

    def Check(  # noqa: N802 - the contract names it
        self, request: health_pb2.HealthCheckRequest, context: grpc.ServicerContext
    ) -> Any:
        """Answer at once."""
        send_reason(context, self.why_not())
        return super().Check(request, context)


class SimulatorServer:
    """A simulator on a port, from `start` to `stop`."""

    def __init__(
        self,
        config: SimulationConfig,
        address: str,
        options: ServerOptions,
        *,
        on_end: Callable[[], None],
    ) -> None:
        """Bind the address; nothing runs yet.

        Args:
            address: ``host:port``, port 0 for any free one, or ``unix:PATH``.
            on_end: Called when a client asks for the end.

        Raises:
            OaisysError: The address cannot be bound.
            InvalidInputError: A certificate or key cannot be used.
        """
        self._options = options
        self._parent = os.getppid()
        self._health = HealthWithReason()
        self._set_ready(False)
        self._supervisor = Supervisor(config, options, self._set_ready)
        self._health.why_not = lambda: self._supervisor.refusal
        self._operations = OperationQueue(self._supervisor)
        self._on_end = on_end
        files = LegacyFiles(options.legacy_folder, config)
        self._legacy = LegacyServicer(
            self._supervisor,
            self._operations,
            files,
            on_end,
            _legacy_pose_policy(config, options),
        )
        self._grpc_log = GrpcLogLimit()
        self._started: Future[None] = Future()
        self._runner = threading.Thread(target=self._run, name="runner")
        # Two servers must not share a port by accident.
        channel_options = [
            ("grpc.so_reuseport", 0),
            # Images are written whole.
            ("grpc.http2.write_buffer_size", 16 << 20),
            ("grpc.http2.bdp_probe", 0),
            ("grpc.max_receive_message_length", MAX_REQUEST_BYTES),
            *connection_options(),
        ]
        self._threads = CallThreads(THREADS, self._note_crowd)
        turns = self._operations.turns
        self._calls = OpenCalls(self._threads.request_came, turns.note_unread)
        self._server = grpc.server(
            self._threads,  # type: ignore[arg-type] # any executor will do
            interceptors=[GuardedCalls(self._calls, turns.note_read)],
            options=channel_options,
        )
        self._add_services()
        self.address = self._bind(address)

    def start(self) -> Future[None]:
        """Answer calls; return what is done once the worker is ready, or has failed to start."""
        remove_abandoned(FOLDER_PREFIX)
        if self._options.worker_log_folder is not None:
            self._supervisor.log.open(self._options.worker_log_folder, self.address)
        self._grpc_log.begin()
        self._server.start()
        self._runner.start()
        return self._started

    def stop(self, at_once: Callable[[], bool] = lambda: True) -> None:
        """End everything within 5 s: calls, worker, port.

        Args:
            at_once: Asked again and again whether calls under way must not be waited for.
        """
        self._health.enter_graceful_shutdown()
        self._operations.drain(self._options.shutdown_grace_s, at_once)
        self._operations.end()
        stopped = self._server.stop(_STOP_S)
        self._legacy.close()
        self._runner.join(0.0 if at_once() else _WORKER_END_S)
        self._supervisor.kill()
        self._runner.join(_WORKER_END_S)
        if not stopped.wait(_STOP_S + _CALLS_END_S):
            _LOG.warning("calls of clients did not end; they are left")
        self._calls.close()
        self._grpc_log.end()
        self._threads.shutdown()
        has_lost_parent = os.getppid() != self._parent
        self.remove_socket(_OWNER_END_S if has_lost_parent else 0.0)

    def remove_socket(self, wait_s: float = 0.0) -> None:
        """Remove a socket, and the folder that a program that was killed had made for it.

        Args:
            wait_s: How long to wait for the end of that program.
        """
        remove_socket(self.address)
        if self.address.startswith(UNIX):
            remove_if_abandoned(unix_path(self.address).parent, wait_s)

    def _add_services(self) -> None:
        """Add all that answers at the port."""
        servicer = SimulatorServicer(
            self._supervisor,
            self._operations,
            self._on_end,
            shared_memory=self._options.shared_memory,
        )
        simulator_pb2_grpc.add_SimulatorServiceServicer_to_server(servicer, self._server)
        oaisys_pb2_grpc.add_OaisysServicer_to_server(self._legacy, self._server)
        health_pb2_grpc.add_HealthServicer_to_server(self._health, self._server)
        names = (SERVICE, LEGACY_SERVICE, health.SERVICE_NAME, reflection.SERVICE_NAME)
        reflection.enable_server_reflection(names, self._server)

    def _run(self) -> None:
        """Start the worker and run the queue; the worker lives as long as this thread."""
        try:
            self._supervisor.start()
        except Exception as error:  # noqa: BLE001 - the main thread raises it
            self._started.set_exception(error)
        else:
            self._started.set_result(None)
            self._operations.run()
        finally:
            self._supervisor.end()

    def _bind(self, address: str) -> str:
        tls = self._options.tls
        credentials = None if tls is None else tls.credentials()
        target = grpc_target(address)
        try:
            with private_socket(address):
                if credentials is None:
                    port = self._server.add_insecure_port(target)
                else:
                    port = self._server.add_secure_port(target, credentials)
        except RuntimeError as error:
            raise OaisysError(f"cannot listen on {address}: {error}") from error
        return address if address.startswith(UNIX) else f"{host_and_port(address)[0]}:{port}"

    def _note_crowd(self, peer: str) -> None:
        self._calls.ended.add(f"a call of {peer}", CROWD)

    def _set_ready(self, ready: bool) -> None:
        answer = health_pb2.HealthCheckResponse
        for name in HEALTH_NAMES:
            self._health.set(name, answer.SERVING if ready else answer.NOT_SERVING)


def _legacy_pose_policy(config: SimulationConfig, options: ServerOptions) -> PosePolicy:
    """Return the pose policy of the original's service; by default it refuses no pose."""
    configured = config.sensors.pose_policy
    return options.legacy_pose_policy or ("clamp" if configured == "reject" else configured)


def serve(
    config: SimulationConfig,
    address: str,
    options: ServerOptions,
    *,
    on_ready: Callable[[str], None],
) -> None:
    """Serve until SIGINT, SIGTERM, SIGHUP, SIGQUIT or a client ends it; call on the main thread.

    Calls under way may go on for a moment, unless a second signal comes. Signals are ignored
    afterwards, so that none interrupts the program on its way out.

    Args:
        on_ready: Called with the address, with its real port, once the worker is ready.

    Raises:
        OaisysError: The address cannot be bound, or the worker does not start.
    """
    end = EndRequest()
    end_service_at_signals(lambda *_: end.request())
    server = SimulatorServer(config, address, options, on_end=end.request)
    started = server.start()

    def tell(started: Future[None]) -> None:
        if started.exception():
            end.request()
        else:
            on_ready(server.address)

    started.add_done_callback(tell)
    try:
        end.wait()
        asked = not started.done()
    finally:
        exit_at_last(started, server.remove_socket)
        server.stop(lambda: end.is_repeated)
        end_service_at_signals(signal.SIG_IGN)
    if not asked and (failure := started.exception()):
        raise failure
