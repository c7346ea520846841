"""The report of a timed drive: ``report.json`` for programs and ``report.html`` for people."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.drive.outputs import RecordedDrive
from oaisys_core.files.whole_files import write_whole_text
from oaisys_core.types import DEPTH, INSTANCE, RGB, FloatArray, Frame, semantic_level
from oaisys_mapping.odometry.checks import OdometryCheck, odometry_checks
from oaisys_mapping.report import drive_pictures, pictures
from oaisys_mapping.report.report import data_url, depth_range_m, versions

REPORT_HTML, REPORT_JSON, PICTURES = "report.html", "report.json", "pictures"

BAG = "bag"
"""The output that is a bag, and the name of its folder."""

FIGURE_NAMES = {
    "poses": "poses",
    "scans": "scans",
    "seconds": "seconds integrated",
    "way_m": "way, m",
    "drift_share": "drift, % of the way",
    "ape_rmse_m": "position error (APE, RMSE), m",
    "ape_rmse_deg": "orientation error (APE, RMSE), degrees",
    "time_offset_s": "stamps are late by, ms",
    "end_error_m": "position error at the end, m",
    "end_error_share": "position error at the end, % of the way",
    "turned_deg": "turned against its mount by, degrees",
}
"""Names of the programs' figures on the page."""

FACTORS = {"drift_share": 100.0, "end_error_share": 100.0, "time_offset_s": 1000.0}
"""From the figures' units in ``report.json`` to those on the page."""


def write_drive_report(drive: RecordedDrive, say: Callable[[str], None]) -> Path:
    """Write ``report.html``, its pictures and ``report.json``; return the page.

    Independent odometry programs that are installed judge the drive first; see
    `oaisys_mapping.odometry`.

    Args:
        drive: The drive.
        say: Called with what is being done.
    """
    folder = drive.description.folder
    checks = odometry_checks(drive, _bag_folder(drive), say)
    figures = _figures(drive, checks)
    images = _pictures(drive)
    (folder / PICTURES).mkdir(exist_ok=True)
    for name, data in images.items():
        (folder / PICTURES / name).write_bytes(data)
    page = folder / REPORT_HTML
    write_whole_text(page, _html(drive, checks, figures, images))
    write_whole_text(folder / REPORT_JSON, json.dumps(figures, indent=2))
    return page


def _bag_folder(drive: RecordedDrive) -> Path | None:
    return drive.description.folder / BAG if BAG in drive.counts else None


def _figures(drive: RecordedDrive, checks: Sequence[OdometryCheck]) -> dict[str, Any]:
    """Return the contents of ``report.json``."""
    bag = _bag_folder(drive)
    return {
        **drive.facts,
        "complete": not drive.losses,
        "lost": drive.losses,
        "counts": {
            output: {name: asdict(count) for name, count in counts.items()}
            for output, counts in drive.counts.items()
        },
        "bag": None if bag is None else bag.name,
        "unavailable": dict(drive.unavailable),
        "odometry_checks": [asdict(check) for check in checks],
        "versions": versions(),
    }


def _pictures(drive: RecordedDrive) -> dict[str, bytes]:
    """Return the image files by name."""
    motion = drive.motion
    files: dict[str, bytes] = {}
    if len(motion.times_s) > 1:
        way_m = np.array([pose.position_m for pose in motion.poses])
        estimated_m = None
        if motion.estimates:
            estimated_m = np.array([each.pose.position_m for each in motion.estimates])
        files["way.png"] = drive_pictures.way_map(drive.ground, way_m, estimated_m)
        error_m: FloatArray | None = None if estimated_m is None else estimated_m - way_m
        files["odometry.png"] = drive_pictures.odometry_chart(
            motion.times_s, motion.velocity_m_s, motion.angular_rate_rad_s, error_m
        )
    for name, measurements in drive.imus.items():
        if len(measurements) > 1:
            files[f"imu_{name}.png"] = drive_pictures.imu_chart(measurements)
    labels = drive.description.info.semantic_labels
    for camera in drive.description.info.sensors:
        for modality in camera.modalities:
            frames = [
                each.frame
                for each in drive.pictures
                if (each.frame.sensor, each.frame.modality) == (camera.name, modality)
            ]
            if frames and (images := _color(frames, labels)):
                sheet = pictures.sheet(images, len(images))
                files[f"camera_{camera.name}_{modality}.jpg"] = pictures.jpeg(sheet)
    return files


def _color(frames: Sequence[Frame], labels: Mapping[int, str]) -> list[NDArray[np.uint8]] | None:
    """Return frames of one modality as pictures; None if it has none."""
    modality = frames[0].modality
    if modality == RGB:
        return [np.asarray(frame.data, np.uint8) for frame in frames]
    if modality == DEPTH:
        return log_depth_pictures([frame.data for frame in frames])
    if modality == INSTANCE:
        return [pictures.instance_picture(frame.data) for frame in frames]
    if semantic_level(modality) is not None:
        return [pictures.semantic_picture(frame.data, labels) for frame in frames]
    return None


def log_depth_pictures(images_m: Sequence[NDArray[np.float32]]) -> list[NDArray[np.uint8]]:
    """Return depth in colours of its logarithm, as `pictures.depth_picture`.

    A horizon is a hundred times as far as the ground in front of a rover.
    """
    with np.errstate(divide="ignore"):
        logs = [np.log(image_m) for image_m in images_m]
    near, far = depth_range_m(logs)
    return [pictures.depth_picture(each, near, far) for each in logs]


def _html(
    drive: RecordedDrive,
    checks: Sequence[OdometryCheck],
    figures: Mapping[str, Any],
    images: Mapping[str, bytes],
) -> str:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("oaisys_mapping", "templates"), autoescape=True
    )
    description = drive.description
    return environment.get_template("drive_report.html.j2").render(
        drive=drive,
        description=description,
        figures=figures,
        checks=[
            {
                "sensor": check.sensor,
                "program": check.program,
                "problem": check.problem,
                "rows": [
                    (FIGURE_NAMES.get(name, name), value * FACTORS.get(name, 1))
                    for name, value in check.figures.items()
                ],
            }
            for check in checks
        ],
        images={name: data_url(name, data) for name, data in images.items()},
        cameras=[name for name in images if name.startswith("camera_")],
        imus=[name for name in images if name.startswith("imu_")],
    )
