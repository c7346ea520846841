"""Scans of lidars come over gRPC bit for bit, whichever way they travel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from served_simulator import FLAT_WORLD, Server, stepped_server

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import OaisysError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.simulation import Simulation
from oaisys_core.types import LidarScan, ModuleMetadata, Sample
from oaisys_grpc.client.simulator_client import SimulatorClient
from oaisys_grpc.contract.sample_messages import (
    FrameMessage,
    sample_from_messages,
    sample_to_messages,
    scan_from_message,
)
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

POSE = pose_looking_down(1, 2, 7)
WORLD: dict[str, Any] = {
    **FLAT_WORLD,
    "sensors": {
        "cameras": [{"width_px": 32, "height_px": 24, "modalities": ["depth"]}],
        "lidars": [
            {
                "name": "large",
                "mount_quat_xyzw": [0.0, -0.70710678, 0.0, 0.70710678],
                "extra_fields": ["label", "instance"],
            },
            {"name": "nothing", "scan": {"kind": "raster"}, "max_range_m": 0.6},
        ],
    },
}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with stepped_server(tmp_path_factory.mktemp("lidar") / "server", WORLD) as running:
        yield running


@pytest.fixture(scope="module")
def expected() -> Sample:
    simulation = Simulation(config_from_mapping(WORLD))
    simulation.step_batch(seed=3)
    return simulation.step_sample(ModuleMetadata(sensor={"pose": POSE}))


def assert_equal(scans: tuple[LidarScan, ...], expected: tuple[LidarScan, ...]) -> None:
    assert [scan.sensor for scan in scans] == [scan.sensor for scan in expected]
    for scan, wanted in zip(scans, expected, strict=True):
        assert scan.data.dtype.names == wanted.data.dtype.names
        assert scan.data.tobytes() == wanted.data.tobytes()
        np.testing.assert_array_equal(scan.T_map_lidar, wanted.T_map_lidar)


@pytest.mark.parametrize(
    "options",
    [{}, {"shared_memory": False}, {"shared_memory": False, "encodings": ("png", "shuffled_zlib")}],
)
def test_a_client_gets_the_scans_that_were_made(
    server: Server, expected: Sample, options: dict[str, Any]
) -> None:
    with SimulatorClient(server.address, timeout_s=60, **options) as client:
        sample = client.render_sample(POSE)
        info = client.info()
        alone = client.render_sample(POSE, sensors=["large"])
        again = client.get_sample(sample.batch_id, sample.sample_id)
    assert len(expected.scan("large").data) > 10_000
    assert len(expected.scan("nothing").data) == 0
    assert_equal(sample.scans, expected.scans)
    assert_equal(again.scans, expected.scans)
    assert_equal(alone.scans, expected.scans[:1])
    assert (len(sample.frames), alone.frames) == (1, ())
    assert sample.outline.frames == expected.outline.frames
    assert [(lidar.name, lidar.extra_fields) for lidar in info.lidars] == [
        ("large", ("label", "instance")),
        ("nothing", ()),
    ]


def test_a_stream_yields_scans_as_soon_as_they_have_come(server: Server, expected: Sample) -> None:
    with server.client() as client, client.stream_sample(POSE) as stream:
        items = list(stream)
    assert {(item.sensor, item.modality) for item in items} == {
        ("camera", "depth"),
        ("large", "points"),
        ("nothing", "points"),
    }
    assert_equal(tuple(item for item in items if isinstance(item, LidarScan)), expected.scans)


def test_messages_of_a_sample_with_scans_come_back_as_they_were(expected: Sample) -> None:
    assert_equal(sample_from_messages(sample_to_messages(expected)).scans, expected.scans)


@pytest.mark.parametrize(
    "field",
    [
        {"name": "x", "offset": 10, "data_type": pb.DATA_TYPE_FLOAT32},
        {"name": "x", "offset": 0, "data_type": 99},
    ],
)
def test_impossible_layouts_of_points_are_refused(field: dict[str, Any]) -> None:
    header = pb.FrameHeader(sensor="lidar", point_fields=[pb.PointField(**field)])
    with pytest.raises(OaisysError):
        scan_from_message(FrameMessage(header, np.zeros((3, 12), np.uint8)))
