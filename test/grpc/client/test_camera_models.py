"""Fisheyes, stereo disparities and rolling shutters come over gRPC as they were made."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from served_simulator import FLAT_WORLD, Server, stepped_server

from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import pose_looking_down
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata
from oaisys_grpc.client.simulator_client import SimulatorClient

SIZE = {"width_px": 32, "height_px": 24, "fx_px": 20.0, "fy_px": 20.0}
POSES = [pose_looking_down(1, 2, 7), pose_looking_down(2, 1, 6, 0.2)]
WORLD: dict[str, Any] = {
    **FLAT_WORLD,
    "sensors": {
        "cameras": [
            {**SIZE, "name": "wide", "fisheye": {"k1": 0.01}, "modalities": ["depth", "normal"]},
            {**SIZE, "name": "rolling", "readout_s": 0.05, "modalities": ["depth", "semantic_0"]},
        ],
        "stereo": [{**SIZE, "name": "eyes", "modalities": ["disparity"]}],
    },
}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with stepped_server(tmp_path_factory.mktemp("cameras") / "server", WORLD) as running:
        yield running


@pytest.mark.long
def test_a_client_gets_what_the_cameras_saw_and_their_models(server: Server) -> None:
    simulation = Simulation(config_from_mapping(WORLD))
    simulation.step_batch(seed=3)
    with SimulatorClient(server.address, timeout_s=60) as client:
        sensors = client.info().sensors
        assert [sensor.intrinsics for sensor in sensors] == [
            sensor.intrinsics for sensor in simulation.info().sensors
        ]
        assert [sensor.intrinsics.is_fisheye for sensor in sensors] == [True, False, False, False]
        for pose in POSES:
            expected = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))
            sample = client.render_sample(pose)
            assert [(f.sensor, f.modality) for f in sample.frames] == [
                (f.sensor, f.modality) for f in expected.frames
            ]
            for frame, wanted in zip(sample.frames, expected.frames, strict=True):
                assert frame.data.tobytes() == wanted.data.tobytes()
                assert frame.intrinsics == wanted.intrinsics
            assert ("rolling" in sample.provenance.previous_poses_json) == (pose is POSES[1])
