"""A client in another language, written from the proto alone, gets what the Python client gets."""

import hashlib
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from repository import REPOSITORY
from served_simulator import Server
from waiting import PATIENCE_S


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the example with its packages installed."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("node and npm are not installed")
    folder = tmp_path_factory.mktemp("node")
    copy = folder / "examples" / "node"
    shutil.copytree(
        REPOSITORY / "examples/node", copy, ignore=shutil.ignore_patterns("node_modules")
    )
    shutil.copytree(REPOSITORY / "oaisys_grpc/proto", folder / "oaisys_grpc" / "proto")
    command = ["npm", "install", "--no-audit", "--no-fund", "--no-package-lock", "--ignore-scripts"]
    try:
        done = subprocess.run(
            command, cwd=copy, capture_output=True, text=True, check=False, timeout=120
        )
    except subprocess.TimeoutExpired:
        pytest.skip("npm could not install the example's packages in time")
    if done.returncode:
        pytest.skip(f"npm could not install the example's packages: {done.stderr[-500:]}")
    return copy


def run(example: Path, address: str, *options: str) -> subprocess.CompletedProcess[str]:
    command = ["node", "step.mjs", "--address", address, "--out", "out", *options]
    return subprocess.run(
        command, cwd=example, capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )


@pytest.mark.long
def test_node_receives_what_python_receives(example: Path, flat_server: Server) -> None:
    done = run(example, flat_server.address, "--seed", "7", "--position", "1,2,6")
    assert done.returncode == 0, done.stderr
    told = {line["modality"]: line for line in map(json.loads, done.stdout.splitlines())}
    assert (told["depth"]["encoding"], told["rgb"]["encoding"]) == (
        "ENCODING_SHUFFLED_ZLIB",
        "ENCODING_PNG",
    )
    with flat_server.client() as client:
        info = client.info()
        sample = client.get_sample(info.batch_id, info.sample_id)
    assert list(sample.rig_pose.position_m) == [1, 2, 6]
    out = example / "out"
    depth = sample.frame("camera", "depth").data
    assert told["depth"]["sha256"] == hashlib.sha256(depth.tobytes()).hexdigest()
    assert (out / "camera_depth.f32").read_bytes() == depth.tobytes()
    assert told["depth"]["nearest_m"] == pytest.approx(6, rel=1e-5)
    rgb = np.asarray(Image.open(out / "camera_rgb.png"))
    assert np.array_equal(rgb, sample.frame("camera", "rgb").data)
    semantic = np.asarray(Image.open(out / "camera_semantic_0.png"))
    assert np.array_equal(semantic, sample.frame("camera", "semantic_0").data)


def test_node_learns_which_field_was_refused(example: Path, flat_server: Server) -> None:
    refused = run(example, flat_server.address, "--position", "0,0,nonsense")
    assert refused.returncode == 1
    assert "INVALID_ARGUMENT" in refused.stderr
    assert "\n  metadata.sensor.pose.position: " in refused.stderr
    failed = run(example, flat_server.address, "--position", "0,0,-50")
    assert failed.returncode == 1
    assert "InvalidInputError (pose.position)" in failed.stderr
