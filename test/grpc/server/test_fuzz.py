"""Ten thousand random and mutated requests; ``make fuzz`` sends others for FUZZ_SECONDS."""

from __future__ import annotations

import os
import secrets
import sys
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import grpc
import numpy as np
import pytest
from fuzzing import OURS, Mutator, Target
from grpc_health.v1 import health_pb2, health_pb2_grpc
from served_simulator import FLAT_WORLD, Server
from waiting import PATIENCE_S

from oaisys_core.geometry import pose_looking_down
from oaisys_grpc.contract.metadata import pose_to_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

StartServer = Callable[..., Server]

CAMERA = {"width_px": 16, "height_px": 12, "fx_px": 14.0, "fy_px": 14.0}
WORLD = {**FLAT_WORLD, "sensors": {"cameras": [CAMERA]}}
REQUESTS = 10_000
BLOCK = 1_000


@pytest.mark.soak
def test_nothing_in_10000_requests_does_harm(start_server: StartServer, tmp_path: Path) -> None:
    """Another server takes only the steps that were accepted: in the end both stand alike."""
    seconds = float(os.environ.get("FUZZ_SECONDS", "0"))
    seed = int(os.environ.get("FUZZ_SEED", secrets.randbits(31) if seconds else 1))
    end_s = time.monotonic() + seconds
    requests = Mutator(np.random.default_rng(seed)).requests()
    servers = [
        start_server(WORLD, "--legacy-out", str(tmp_path / f"legacy{n}"), "--pose-cache-mb", "0")
        for n in range(2)
    ]
    worker = servers[0].worker().pid
    sent = 0
    with (
        grpc.insecure_channel(servers[0].address) as fuzzed,
        grpc.insecure_channel(servers[1].address) as spared,
    ):
        target, control = Target(fuzzed), Target(spared)
        for each in (target, control):
            assert each.send(OURS + "StepBatch", b"")
        while sent < REQUESTS or time.monotonic() < end_s:
            for path, data in islice(requests, BLOCK):
                if target.send(path, data):
                    assert control.send(path, data), f"seed {seed}: {path} {data!r}"
                sent += 1
            assert _stands(target) == _stands(control), f"seed {seed}, after {sent} requests"
        assert not target.unexpected, f"seed {seed}: " + "\n".join(target.unexpected[:20])
        sys.stdout.write(f"seed {seed}: {sent} requests, {dict(target.counts)}\n")
        assert target.counts["OK"] > sent / 20
        assert sum(target.counts.values()) - target.counts["OK"] > sent / 5
        health = health_pb2_grpc.HealthStub(fuzzed)
        answer = health.Check(health_pb2.HealthCheckRequest(), timeout=PATIENCE_S)
        assert answer.status == health_pb2.HealthCheckResponse.SERVING
        info = target.ask(OURS + "GetSimulatorInfo", pb.GetSimulatorInfoRequest())
    assert (servers[0].worker().pid, info.worker_restarts) == (worker, 0)


def _stands(target: Target) -> tuple[int, int, bytes]:
    """Ids and the depth that comes next at one pose: equal for simulators that stand alike."""
    pose = pose_to_proto(pose_looking_down(1, 2, 7))
    request = pb.RenderSampleRequest(
        metadata=pb.ModuleMetadata(sensor=pb.SensorMetadata(pose=pose)), modalities=["depth"]
    )
    assert target.send(OURS + "RenderSample", request.SerializeToString())
    info = target.ask(OURS + "GetSimulatorInfo", pb.GetSimulatorInfoRequest())
    sample = pb.GetFrameRequest(
        batch_id=info.batch_id, sample_id=info.sample_id, sensor="camera", modality="depth"
    )
    frame = target.ask(OURS + "GetFrame", sample).frame
    assert frame.data
    return info.batch_id, info.sample_id, frame.data
