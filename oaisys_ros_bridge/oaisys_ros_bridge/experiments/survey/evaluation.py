"""Evaluates the map of a survey, and writes the report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from oaisys_core.geometry import T_LINK_OPTICAL, pose_to_matrix
from oaisys_core.types import DEPTH, Pose, SensorInfo, TriangleMesh
from oaisys_mapping.certificate.perturbations import PosedDepth
from oaisys_mapping.evaluation.thresholds import survey_thresholds
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.rectification import rectify_camera
from oaisys_ros_bridge.experiments.evaluation.map_evaluation import evaluate_and_certify
from oaisys_ros_bridge.experiments.planner_client import ReceivedView
from oaisys_ros_bridge.experiments.progress import Reporter
from oaisys_ros_bridge.experiments.report import ExperimentRun, write_experiment_report
from oaisys_ros_bridge.experiments.survey.plan import SurveyOptions, survey_columns


@dataclass(frozen=True)
class SurveyResult:
    """What a survey has received until its simulator was ended.

    Attributes:
        sensor: The camera.
        poses: Of its link, one per view.
        run: The views, and what was lost.
        truth: The true surface.
        begun_s: When the survey began, in seconds since the start.
        first_picture_s: When the first picture was written; None: there are no colour images.
    """

    sensor: SensorInfo
    poses: Sequence[Pose]
    run: ExperimentRun
    truth: TriangleMesh
    begun_s: float
    first_picture_s: float | None


def report_survey(
    options: SurveyOptions,
    survey: SurveyResult,
    reporter: Reporter,
    elapsed_s: Callable[[], float],
) -> bool:
    """Evaluate the map, write the report, and return whether the map agrees with the true surface.

    Args:
        options: Of the survey.
        survey: What was received.
        reporter: Says what is being done.
        elapsed_s: Returns the seconds since the start.
    """
    views = _views(survey.sensor, survey.poses)
    result = evaluate_and_certify(
        options,
        survey.run.info,
        survey.truth,
        views,
        _frames(survey.sensor, views, survey.run.views) if options.faults else [],
        survey_thresholds(options.voxel_size_m),
        reporter,
    )
    return write_experiment_report(
        options,
        survey.run,
        result,
        reporter,
        title="Survey of a rendered terrain",
        columns=survey_columns(options.views),
        facts={
            "altitude_m": options.altitude_m,
            "overlap": options.overlap,
            "seconds_to_first_picture": survey.first_picture_s,
        },
        seconds_total=elapsed_s() - survey.begun_s,
        elapsed_s=elapsed_s,
    )


def _views(sensor: SensorInfo, poses: Sequence[Pose]) -> list[PosedCamera]:
    """Return the rectified cameras, as the mapper fuses them, from poses of the sensor's link."""
    camera = rectify_camera(sensor.intrinsics)
    return [PosedCamera(camera, pose_to_matrix(pose) @ T_LINK_OPTICAL) for pose in poses]


def _frames(
    sensor: SensorInfo, views: Sequence[PosedCamera], received: Sequence[ReceivedView]
) -> list[PosedDepth]:
    """Return the received depth images, each with its camera and pose."""
    return [
        PosedDepth(images[DEPTH], sensor.intrinsics, view.T_map_camera)
        for view, images in zip(views, (one.images for one in received), strict=True)
        if DEPTH in images
    ]
