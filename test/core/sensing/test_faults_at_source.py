"""Depth noise and drift in the frames that the simulator makes, as `sensors.faults` says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.output.poses import read_poses
from oaisys_core.output.reader import read_sample
from oaisys_core.output.writer import SampleWriter
from oaisys_core.sensing.faults import CaptureId, DepthFaults, PoseDrift, measure_frame
from oaisys_core.simulation import Simulation
from oaisys_core.types import Frame, ModuleMetadata, Sample

CAMERA = {
    "width_px": 24,
    "height_px": 18,
    "fx_px": 20.0,
    "fy_px": 20.0,
    "modalities": ["depth", "range", "semantic_0", "instance"],
}
NOISE = {"seed": 9, "depth_noise": "quadratic", "missing_ratio": 0.1, "max_depth_m": 10.5}
DRIFT = {"drift_m": 0.5, "drift_rad": 0.1}


def simulation(faults: dict[str, Any] | None = None, cache_bytes: int = 0) -> Simulation:
    cameras = [{"name": "left", **CAMERA}, {"name": "right", **CAMERA}]
    data = {
        "backend": "analytic",
        "stage": {"extent_m": 30.0, "resolution_px": 33, "surroundings": "plain"},
        "materials": {"texture_size_px": 32, "mask": {"size_px": 32, "relief": 0}},
        "assets": {"rocks": []},
        "sensors": {"cameras": cameras, "faults": faults or {}},
    }
    sim = Simulation(config_from_mapping(data), pose_cache_bytes=cache_bytes)
    sim.step_batch(seed=5)
    return sim


def changed(**faults: Any) -> ModuleMetadata:
    return ModuleMetadata(sensor={"faults": faults})


def images(sample: Sample) -> dict[tuple[str, str], bytes]:
    return {(f.sensor, f.modality): f.data.tobytes() for f in sample.frames}


def expected(frame: Frame, faults: DepthFaults, sample: Sample) -> bytes:
    capture = CaptureId(sample.batch_id, sample.sample_id, frame.sensor)
    return measure_frame(frame, faults, capture).data.tobytes()


def test_frames_have_the_noise_of_their_sample_and_sensor() -> None:
    true, noisy = simulation(), simulation(NOISE)
    faults = DepthFaults(9, "quadratic", max_depth_m=10.5, missing_ratio=0.1)
    for _ in range(2):
        truth, sample = true.step_sample(), noisy.step_sample()
        told = {(f.sensor, f.modality): expected(f, faults, truth) for f in truth.frames}
        assert images(sample) == told
        depth_m = sample.frame("left", "depth").data
        assert np.isnan(depth_m).any()
        assert np.isposinf(depth_m).any()
        assert images(sample)["left", "depth"] != images(sample)["right", "depth"]
        assert images(sample)["left", "instance"] == images(truth)["left", "instance"]
    assert truth.odometry is None


def test_a_world_that_is_built_again_may_have_the_same_faults() -> None:
    """Faults are drawn from the number of the batch, which counts on: each had others."""
    again = simulation(NOISE | DRIFT | {"batch": 7})
    first = [again.step_sample() for _ in range(2)]
    again.step_batch(seed=5)
    for before in first:
        after = again.step_sample()
        assert (after.batch_id, before.batch_id) == (2, 1)
        assert images(after) == images(before)
        assert after.odometry == before.odometry
    assert images(first[0]) != images(first[1])
    faults = DepthFaults(9, "quadratic", max_depth_m=10.5, missing_ratio=0.1)
    truth = simulation().step_sample().frame("left", "depth")
    told = measure_frame(truth, faults, CaptureId(7, 1, "left")).data
    assert images(first[0])["left", "depth"] == told.tobytes()


def test_metadata_switches_noise_until_the_next_batch() -> None:
    true, noisy = simulation(), simulation(NOISE)
    assert images(noisy.step_sample(changed(enabled=False))) == images(true.step_sample())
    assert images(noisy.step_sample()) == images(true.step_sample())
    louder = noisy.step_sample(changed(enabled=True, depth_noise="gaussian", depth_sigma_m=1.0))
    faults = DepthFaults(9, "gaussian", 1.0, max_depth_m=10.5, missing_ratio=0.1)
    truth = true.step_sample()
    assert images(louder)["left", "depth"] == expected(truth.frame("left", "depth"), faults, truth)
    noisy.step_batch(seed=5)
    true.step_batch(seed=5)
    assert images(noisy.step_sample()) != images(true.step_sample())


def test_a_view_that_comes_again_has_noise_of_its_own() -> None:
    sim = simulation(NOISE, cache_bytes=10**7)
    first, second = sim.step_sample(), sim.step_sample()
    assert not second.from_cache
    assert images(first)["left", "depth"] != images(second)["left", "depth"]
    off = sim.step_sample(changed(enabled=False))
    assert sim.step_sample().from_cache
    assert images(sim.step_sample()) == images(off)
    noisy = sim.step_sample(changed(enabled=True))
    assert not noisy.from_cache
    assert images(noisy)["left", "depth"] != images(off)["left", "depth"]
    labels = ("semantic_0", "instance")
    sim.step_sample(modalities=labels)
    assert sim.step_sample(modalities=labels).from_cache


def test_odometry_drifts_and_the_truth_stays() -> None:
    sim = simulation({"seed": 3, **DRIFT})
    for number in (1, 2, 3):
        sample = sim.step_sample()
        assert sample.odometry is not None
        drifted = PoseDrift().estimate(sample.rig_pose, (0.5, 0.1), 3, 1, number)
        assert sample.odometry.pose == drifted
        steps = (number - 1) ** 0.5
        assert sample.odometry.sigma_m == pytest.approx(0.5 * steps)
        assert sample.odometry.sigma_rad == pytest.approx(0.1 * steps)
        assert (drifted == sample.rig_pose) == (number == 1)
    assert sim.step_sample(changed(enabled=False)).odometry is None


def test_a_record_repeats_noise_and_drift() -> None:
    sim, other = simulation({**NOISE, **DRIFT}), simulation({**NOISE, **DRIFT})
    sim.step_sample()
    for metadata in (None, changed(depth_noise="kinect"), changed(drift_m=0.25)):
        sample = sim.step_sample(metadata)
        again = other.repeat(sample.outline)
        assert images(again) == images(sample)
        assert again.odometry == sample.odometry
    resumed = simulation({**NOISE, **DRIFT})
    resumed.restore(json.loads(json.dumps(sim.state())))
    assert images(resumed.step_sample()) == images(sim.step_sample())


def test_files_hold_odometry_beside_the_poses(tmp_path: Path) -> None:
    sim = simulation({**NOISE, **DRIFT})
    writer = SampleWriter(tmp_path)
    samples = [sim.step_sample() for _ in range(2)]
    for sample in samples:
        writer.write(sample)
    assert read_poses(tmp_path / "batch_0001/poses.csv") == [s.rig_pose for s in samples]
    drifted = [s.odometry.pose for s in samples if s.odometry]
    assert read_poses(tmp_path / "batch_0001/odometry.csv") == drifted
    found = read_sample(tmp_path / "batch_0001", 2)
    assert found.odometry == samples[1].odometry
    assert images(found) == images(samples[1])


@pytest.mark.parametrize(
    ("faults", "path"),
    [
        ({"depth_noise": "loud"}, "depth_noise"),
        ({"missing_ratio": 1.5}, "missing_ratio"),
        ({"min_depth_m": 3.0, "max_depth_m": 2.0}, "max_depth_m"),
        ({"tf_drifts": True}, "tf_drifts"),
    ],
)
def test_what_does_not_fit_is_refused(faults: dict[str, Any], path: str) -> None:
    with pytest.raises(ConfigError, match=f"sensors.faults.*{path}"):
        simulation(faults)
    sim = simulation()
    for step in (sim.step_batch, sim.step_sample):
        with pytest.raises(InvalidInputError, match=r"metadata\.sensor\.faults"):
            step(changed(**faults))
    with pytest.raises(InvalidInputError, match=r"metadata\.sensor\.faults.*a mapping of"):
        sim.step_sample(ModuleMetadata(sensor={"faults": 3}))
