"""Faults of sensors against the laws that they are said to follow, in closed form."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from oaisys_core.config import config_from_mapping
from oaisys_core.sensing.faults import (
    NOISE_LAWS,
    CaptureId,
    DepthFaults,
    NoiseLaw,
    PoseDrift,
    drift_covariance,
    measure_depth,
    measure_frame,
    odometry_covariance,
)
from oaisys_core.simulation import Simulation
from oaisys_core.types import Pose
from oaisys_ros_bridge.parameters.bridge import BRIDGE
from oaisys_ros_bridge.publishing.sample_publisher import depth_faults

SHAPE = (240, 320)
FX_PX = 541.14
CAPTURE = CaptureId(1, 1, "camera")
UNLIKELY = 1e-6
"""Smallest probability that a test of a true hypothesis may find; draws are fixed by seeds."""


def flat(depth_m: float) -> np.ndarray:
    return np.full(SHAPE, depth_m, np.float32)


def measured(depth_m: float, faults: DepthFaults, capture: CaptureId = CAPTURE) -> np.ndarray:
    return measure_depth(flat(depth_m), FX_PX, faults, capture).astype(np.float64).ravel()


def test_without_faults_an_image_is_what_it_was() -> None:
    depth_m = flat(3.0)

    assert measure_depth(depth_m, FX_PX, DepthFaults(seed=9), CAPTURE) is depth_m


def test_parameters_offer_all_laws_and_no_fault_by_default() -> None:
    defaults = {row.name: row.default for row in BRIDGE}

    assert BRIDGE["faults.depth_noise"].choices == NOISE_LAWS
    assert depth_faults(defaults) == DepthFaults()
    assert (defaults["faults.drift_m"], defaults["faults.drift_rad"]) == (0.0, 0.0)
    for name, value in (
        ("faults.depth_noise", "kinect"),
        ("faults.min_depth_m", 0.1),
        ("faults.max_depth_m", 9.0),
        ("faults.missing_ratio", 0.1),
    ):
        assert depth_faults({**defaults, name: value}).active


@pytest.mark.parametrize("noise", [law for law in NOISE_LAWS if law != "none"])
def test_truth_is_left_alone(noise: NoiseLaw) -> None:
    depth_m = flat(3.0)

    measure_depth(depth_m, FX_PX, DepthFaults(noise=noise, missing_ratio=0.5), CAPTURE)

    assert (depth_m == 3.0).all()


@pytest.mark.parametrize("depth_m", [0.8, 5.0, 40.0])
@pytest.mark.parametrize("noise", ["gaussian", "quadratic"])
def test_normal_errors_have_the_standard_deviation_of_their_law(
    noise: NoiseLaw, depth_m: float
) -> None:
    faults = DepthFaults(seed=3, noise=noise, sigma_m=0.02, sigma_per_m=0.001)
    sigma_m = 0.02 if noise == "gaussian" else 0.02 + 0.001 * depth_m**2

    error_m = measured(depth_m, faults) - depth_m

    assert stats.kstest(error_m / sigma_m, "norm").pvalue > UNLIKELY
    # (n - 1) s^2 / sigma^2 is chi-squared: at this n it tells 1 % of sigma.
    chi2 = (error_m.size - 1) * error_m.var(ddof=1) / sigma_m**2
    assert UNLIKELY < stats.chi2.cdf(chi2, error_m.size - 1) < 1 - UNLIKELY
    assert abs(error_m.mean()) < 6 * sigma_m / np.sqrt(error_m.size)


@pytest.mark.parametrize("depth_m", [0.9, 2.5, 6.0])
def test_a_kinect_rounds_a_noisy_disparity_to_an_eighth_of_a_pixel(depth_m: float) -> None:
    eighths_m = 8 * FX_PX * 0.075

    found_m = measured(depth_m, DepthFaults(seed=4, noise="kinect"))

    eighths = eighths_m / found_m
    steps = np.rint(eighths).astype(int)
    np.testing.assert_allclose(eighths, steps, rtol=1e-6)
    levels = np.arange(steps.min() - 1, steps.max() + 2)
    edges = np.concatenate(([-np.inf], levels[1:] - 0.5, [np.inf]))
    shares = np.diff(stats.norm.cdf(edges, eighths_m / depth_m, 1 / 6))
    counts = np.array([(steps == level).sum() for level in levels])
    likely = shares * steps.size > 5
    expected = np.append(shares[likely], 1 - shares[likely].sum()) * steps.size + 1e-9
    observed = np.append(counts[likely], steps.size - counts[likely].sum())
    assert stats.chisquare(observed, expected * observed.sum() / expected.sum()).pvalue > UNLIKELY


def test_a_kinect_errs_with_the_square_of_depth() -> None:
    # Over depths that hit the steps evenly, rounding is as good as uniform noise of variance 1/12.
    for depth_m in (3.0, 6.0):
        ramp_m = np.linspace(0.95 * depth_m, 1.05 * depth_m, SHAPE[0] * SHAPE[1], dtype=np.float32)
        # Rows of one depth each: who looks aside along a row sees the same.
        image_m = np.broadcast_to(ramp_m.reshape(SHAPE).mean(axis=1, keepdims=True), SHAPE)
        found_m = measure_depth(
            np.ascontiguousarray(image_m), FX_PX, DepthFaults(seed=5, noise="kinect"), CAPTURE
        )
        sigma_m = (found_m - image_m).astype(np.float64).std()
        # What lies half a pixel beside is another depth, too: steps of the ramp, 0.1 z / 240.
        aside_m = 0.1 * depth_m / SHAPE[0] * np.sqrt(0.5**2 + 1 / 12)
        in_steps = depth_m**2 / (8 * FX_PX * 0.075) * np.sqrt(1 / 36 + 1 / 12)
        assert sigma_m == pytest.approx(np.hypot(in_steps, aside_m), rel=0.03)


def test_a_kinect_looks_beside_its_pixels() -> None:
    edge_m = flat(2.0)
    edge_m[:, 160:] = np.inf

    found_m = measure_depth(edge_m, FX_PX, DepthFaults(seed=6, noise="kinect"), CAPTURE)

    # The rounded shift k of N(0, 1/2) is -1 or less with probability P(N < -1/2).
    share = np.isfinite(found_m[:, 160]).mean()
    expected = stats.norm.cdf(-0.5, scale=0.5)
    assert share == pytest.approx(expected, abs=6 * np.sqrt(expected / SHAPE[0]))
    assert np.isinf(found_m[:, 170:]).all()
    assert np.isfinite(found_m[:, :150]).all()


def test_what_is_out_of_range_is_told_as_rep_117_has_it() -> None:
    depth_m = np.array([[0.2, 0.5, 3.0, 8.0, 8.5, np.inf]], np.float32)

    found_m = measure_depth(depth_m, FX_PX, DepthFaults(min_depth_m=0.5, max_depth_m=8.0), CAPTURE)

    np.testing.assert_array_equal(found_m[0], [-np.inf, 0.5, 3.0, 8.0, np.inf, np.inf])


def test_limits_hold_for_what_is_measured() -> None:
    faults = DepthFaults(seed=1, noise="gaussian", sigma_m=0.1, min_depth_m=1.0, max_depth_m=1.2)

    found_m = measured(1.1, faults)

    share = stats.norm.cdf(-1.0)
    tolerance = 6 * np.sqrt(share / found_m.size)
    assert (found_m == -np.inf).mean() == pytest.approx(share, abs=tolerance)
    assert (found_m == np.inf).mean() == pytest.approx(share, abs=tolerance)
    inside_m = found_m[np.isfinite(found_m)]
    assert inside_m.min() >= 1.0 - 1e-6
    assert inside_m.max() <= 1.2 + 1e-6


def test_noise_never_makes_a_depth_behind_the_camera() -> None:
    found_m = measured(0.05, DepthFaults(noise="gaussian", sigma_m=0.1))

    assert (found_m == -np.inf).mean() == pytest.approx(stats.norm.cdf(-0.5), abs=0.01)
    assert (found_m[np.isfinite(found_m)] > 0).all()


@pytest.mark.parametrize("ratio", [0.01, 0.3, 1.0])
def test_pixels_go_missing_one_by_one(ratio: float) -> None:
    image_m = flat(2.0)
    image_m[:100] = np.inf

    missing = np.isnan(measure_depth(image_m, FX_PX, DepthFaults(missing_ratio=ratio), CAPTURE))

    for part in (missing[:100], missing[100:]):
        assert stats.binomtest(int(part.sum()), part.size, ratio).pvalue > UNLIKELY
    if ratio < 1:
        pairs = stats.contingency.crosstab(missing[:, :-1].ravel(), missing[:, 1:].ravel()).count
        assert stats.chi2_contingency(pairs).pvalue > UNLIKELY


def test_draws_depend_on_the_shot_and_on_nothing_that_was_asked_before() -> None:
    faults = DepthFaults(seed=7, noise="quadratic", missing_ratio=0.1)
    captures = [CaptureId(b, s, n) for b in (1, 2) for s in (1, 2) for n in ("left", "right")]
    there = {capture: measured(4.0, faults, capture) for capture in captures}
    back = {capture: measured(4.0, faults, capture) for capture in reversed(captures)}

    for capture in captures:
        np.testing.assert_array_equal(there[capture], back[capture])
        assert not np.array_equal(measured(4.0, replace(faults, seed=8), capture), there[capture])
        for other in captures:
            if other != capture:
                both = np.isfinite(there[capture]) & np.isfinite(there[other])
                r = stats.pearsonr(there[capture][both], there[other][both])
                assert r.pvalue > UNLIKELY


def test_switching_one_fault_on_leaves_the_others_as_they_were() -> None:
    noisy = measured(4.0, DepthFaults(noise="gaussian"))
    both = measured(4.0, DepthFaults(noise="gaussian", missing_ratio=0.2))
    missing = np.isnan(measured(4.0, DepthFaults(missing_ratio=0.2)))

    np.testing.assert_array_equal(np.isnan(both), missing)
    np.testing.assert_array_equal(both[~missing], noisy[~missing])


def walks(batches: int, sample_id: int) -> np.ndarray:
    drift = PoseDrift()
    return np.array([drift.unit_walk(11, batch, sample_id) for batch in range(1, batches + 1)])


@pytest.mark.parametrize("sample_id", [2, 30, 400])
def test_a_pose_walks_at_random(sample_id: int) -> None:
    found = walks(400, sample_id) / np.sqrt(sample_id - 1)

    for axis in range(6):
        assert stats.kstest(found[:, axis], "norm").pvalue > UNLIKELY
    spread = np.corrcoef(found.T) - np.eye(6)
    assert np.abs(spread).max() < 6 / np.sqrt(len(found))


def test_steps_of_a_walk_do_not_know_each_other() -> None:
    drift = PoseDrift()
    sums = np.array([drift.unit_walk(5, 1, sample_id) for sample_id in range(1, 3001)])
    steps = np.diff(sums, axis=0)

    assert (sums[0] == 0).all()
    for axis in range(6):
        assert stats.kstest(steps[:, axis], "norm").pvalue > UNLIKELY
        assert stats.pearsonr(steps[:-1, axis], steps[1:, axis]).pvalue > UNLIKELY


def test_a_walk_is_the_same_in_whatever_order_it_is_asked_for() -> None:
    order = [1000, 3, 257, 256, 258, 1, 999]
    forward, other = PoseDrift(), PoseDrift()
    sums = {i: forward.unit_walk(5, 2, i) for i in sorted(order)}

    for i in order:
        np.testing.assert_array_equal(other.unit_walk(5, 2, i), sums[i])
    other.unit_walk(5, 3, 10)
    np.testing.assert_array_equal(other.unit_walk(5, 2, 3), sums[3])


def test_a_drifted_pose_is_moved_and_turned_about_the_axes_of_the_map() -> None:
    drift = PoseDrift()
    x, y, z, w = Rotation.from_euler("xyz", [0.3, -0.2, 1.1]).as_quat()
    pose = Pose((1.0, 2.0, 3.0), (x, y, z, w))
    walk = drift.unit_walk(5, 1, 50)

    found = drift.estimate(pose, (0.02, 0.003), 5, 1, 50)

    np.testing.assert_allclose(found.position_m, np.array([1, 2, 3]) + 0.02 * walk[:3])
    turn = Rotation.from_quat(found.quat_xyzw) * Rotation.from_quat(pose.quat_xyzw).inv()
    np.testing.assert_allclose(turn.as_rotvec(), 0.003 * walk[3:], atol=1e-12)
    assert drift.estimate(pose, (0.0, 0.0), 5, 1, 50) is pose


def test_covariance_is_that_of_the_walk() -> None:
    covariance = drift_covariance((0.02, 0.003), 26).reshape(6, 6)

    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [0.1] * 3 + [0.015] * 3)
    assert np.count_nonzero(covariance) == 6
    assert not drift_covariance((0.02, 0.003), 1).any()


@pytest.mark.parametrize("law", NOISE_LAWS)
def test_the_simulator_makes_the_noise_that_the_bridge_makes(law: NoiseLaw) -> None:
    """`sensors.faults` and the parameters `faults.*` of the same names and values."""
    faults = {"seed": 12, "depth_noise": law, "depth_sigma_m": 0.1, "missing_ratio": 0.05}
    faults |= {"max_depth_m": 9.0, "drift_m": 0.5, "drift_rad": 0.1}
    camera = {"name": "front", "modalities": ["depth", "range"], "width_px": 32, "height_px": 24}
    world: dict[str, Any] = {
        "backend": "analytic",
        "stage": {"surroundings": "plain", "resolution_px": 33},
    }
    world |= {"materials": {"texture_size_px": 64, "mask": {"size_px": 64, "relief": 0}}}
    world |= {"assets": {"rocks": []}}
    samples = []
    for given in ({}, faults):
        sensors = {"cameras": [camera], "faults": given}
        sim = Simulation(config_from_mapping({**world, "sensors": sensors}))
        sim.step_batch(seed=1)
        samples.append([sim.step_sample() for _ in range(2)][-1])
    true, simulated = samples
    values = {row.name: row.default for row in BRIDGE}
    added = depth_faults(values | {f"faults.{k}": v for k, v in faults.items()})
    for frame in true.frames:
        published = measure_frame(
            frame, added, CaptureId(true.batch_id, true.sample_id, "front")
        ).data
        found = simulated.frame("front", frame.modality).data
        np.testing.assert_array_equal(published, found)
        assert (published != frame.data).any()
    drift = PoseDrift().estimate(true.rig_pose, (0.5, 0.1), 12, 1, 2)
    assert simulated.odometry is not None
    assert simulated.odometry.pose == drift
    covariance = np.diag(drift_covariance((0.5, 0.1), 2).reshape(6, 6))
    np.testing.assert_allclose(
        np.diag(odometry_covariance(simulated.odometry).reshape(6, 6)), covariance
    )
