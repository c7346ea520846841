"""Maps of perturbed frames: each perturbation is rejected, by the figure that shows it."""

import numpy as np
import pytest
from surfaces import depth_seen, down, hills

from oaisys_core.types import PinholeIntrinsics, TriangleMesh
from oaisys_mapping.certificate.perturbations import (
    PERTURBATIONS,
    PerturbationResult,
    PosedDepth,
    run_perturbation_tests,
)
from oaisys_mapping.evaluation.thresholds import Thresholds
from oaisys_mapping.evaluation.true_surface import true_surface
from oaisys_mapping.tsdf import TsdfConfig

pytestmark = pytest.mark.long

CAMERA = PinholeIntrinsics(160, 120, 135.285, 135.285, 79.5, 59.5)
LIMITS = Thresholds(
    max_rmse_m=0.03, min_completion=0.98, min_f_score=0.98, max_median_m=0.005, max_offset_m=0.005
)


@pytest.fixture(scope="module")
def records() -> dict[str, PerturbationResult]:
    """Six views of hills, ray cast by Open3D."""
    truth = TriangleMesh(*hills(9.0, 0.05))
    views = [down(x_m, y_m, 6.0, CAMERA) for x_m in (-1.6, 1.6) for y_m in (-2.5, 0.0, 2.5)]
    frames = [PosedDepth(depth_seen(truth, view), CAMERA, view.T_map_camera) for view in views]
    surface = true_surface(truth, views, 0.1, 60.0, np.random.default_rng(0))
    found = run_perturbation_tests(frames, surface, LIMITS, TsdfConfig(), seed=0)
    return {record.name: record for record in found}


def test_the_unperturbed_map_is_accepted(records: dict[str, PerturbationResult]) -> None:
    assert list(records) == ["none", *(fault.name for fault in PERTURBATIONS)]
    assert not records["none"].missed
    assert records["none"].figures["offset_m"] < 0.002


def test_every_perturbation_is_rejected(records: dict[str, PerturbationResult]) -> None:
    assert all(records[fault.name].is_rejected for fault in PERTURBATIONS)
    assert records["focal_length"].to_dict()["rejected"] is True


def test_a_shift_of_all_poses_appears_as_the_offset_of_the_map(
    records: dict[str, PerturbationResult],
) -> None:
    for name in ("pose_beside", "pose_above"):
        assert records[name].figures["offset_m"] == pytest.approx(0.02, abs=0.002)
    assert records["pose_beside"].figures["rmse_m"] < 0.03, "the RMSE alone does not see it"


def test_large_perturbations_have_large_errors(records: dict[str, PerturbationResult]) -> None:
    assert records["range_as_depth"].figures["rmse_m"] > 0.1
    assert records["focal_length"].figures["rmse_m"] > 0.03
    assert records["pose_scattered"].figures["accuracy_median_m"] > 0.005
