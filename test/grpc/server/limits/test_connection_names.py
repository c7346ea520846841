"""Clients of one Unix socket are known apart, so that each has turns of its own."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import grpc
from served_simulator import FLAT_WORLD

from oaisys_core.config import config_from_mapping
from oaisys_grpc.client.channel import Channel, batch_request, sample_request
from oaisys_grpc.contract.connection_names import CLIENT_KEY, MAX_ID_CHARACTERS, connection_name
from oaisys_grpc.contract.operation import Kind
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2_grpc
from oaisys_grpc.server.jobs.queue import OperationQueue
from oaisys_grpc.server.options import ServerOptions
from oaisys_grpc.server.servicer import SimulatorServicer
from oaisys_grpc.server.supervision.supervisor import Supervisor

WAIT_S = 60.0


@contextmanager
def queue_at(address: str) -> Iterator[OperationQueue]:
    """Serve, without a worker; yield what the clients have enqueued."""
    options = ServerOptions(worker_log_folder=None)
    supervisor = Supervisor(config_from_mapping(FLAT_WORLD), options, lambda _: None)
    operations = OperationQueue(supervisor)
    server = grpc.server(ThreadPoolExecutor(4))
    servicer = SimulatorServicer(supervisor, operations, lambda: None, shared_memory=False)
    simulator_pb2_grpc.add_SimulatorServiceServicer_to_server(servicer, server)
    server.add_insecure_port(address)
    server.start()
    try:
        yield operations
    finally:
        server.stop(None).wait()


def test_a_view_waits_for_one_batch_of_another_client_of_the_socket(tmp_path: Path) -> None:
    address = f"unix:{tmp_path / 'socket'}"
    with queue_at(address) as operations:
        busy, viewer = Channel(address, None), Channel(address, None)
        for seed in range(3):
            busy.call("StepBatch", batch_request(WAIT_S, seed, False, None, ""), WAIT_S)
        request = sample_request(WAIT_S, None, None, (), (), "")
        viewer.call("StepSample", request, WAIT_S)
        order = [operations._next() for _ in range(4)]
        for channel in (busy, viewer):
            channel.close()
    kinds = [operation.job.kind for operation in order if operation is not None]
    assert kinds == [Kind.BATCH, Kind.SAMPLE, Kind.BATCH, Kind.BATCH]


def test_only_where_connections_have_no_name_the_client_s_id_counts() -> None:
    mine = [("user-agent", "grpc"), (CLIENT_KEY, "0a1b")]
    assert connection_name("unix:", mine) == "unix:0a1b"
    assert connection_name("ipv4:127.0.0.1:40000", mine) == "ipv4:127.0.0.1:40000"
    assert connection_name("unix:", None) == "unix:"
    for unusable in ("", "a b", "ä", "x" * (MAX_ID_CHARACTERS + 1), "a\n", b"\xff"):
        assert connection_name("unix:", [(CLIENT_KEY, unusable)]) == "unix:"
