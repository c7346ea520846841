"""Programs that others wrote judge sensors and poses: KISS-ICP, COLMAP, Open3D, OpenCV, GTSAM, evo.

A fault that they are to find is injected into what each of them is given: a focal length, stamps of
a lidar, an IMU's mount.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings, say_of_part
from tools.bench.worlds.panel import DEMO

QUALITIES, QUICK_QUALITIES = ("preview", "standard", "high"), ("preview",)
GRID, QUICK_GRID = (6, 5), (4, 3)
FLIGHT_PICTURES, QUICK_FLIGHT_PICTURES = 20, 12
DRIFTS, QUICK_DRIFTS = 150, 40
SEED = 3

CANYON = "stage_canyon"
DRIVES: dict[str, dict[str, Any]] = {
    "demo": {"world": DEMO},
    "canyon": {"world": CANYON},
    "slalom": {
        "world": CANYON,
        "slalom_m": (0.8, 10.0),
        "rover": {"speed_m_s": 2.5, "acceleration_m_s2": 2.0},
    },
}
"""Drives, by the name of their figures. The slalom's yaw rate swings between 45 deg/s to the left
and as much to the right, every 2 s."""
WAY_M, QUICK_WAY_M = 200.0, 40.0

KNOWN_PX, UNKNOWN_PX = 2.0, 3.0
"""Largest RMS error of positions in pixels on the ground, with K and without."""
FOCAL_PERCENT, PRINCIPAL_PX = 0.3, 2.0
"""Largest errors of a K that is found."""
DRIFT_PERCENT = 0.5
WORSE = 1.5
"""Least drift with points' times ignored, as a multiple of that with points moved by their times
and the true motion. KISS-ICP's own correction supposes the motion of the scan before, which does
not hold where the way winds: of it, no more is asked than to be better than none."""
LATE_MS, OFFSET_MS = 20.0, 5.0
"""By which stamps of a lidar are late, and the largest error of what is found of it."""
TURNED_DEG, TURNED_ERROR_DEG = 2.0, 0.1
"""By which an IMU is turned, and the largest error of what is found of it."""
IMU_PERCENT = 0.1
APE_PERCENT = 15.0
"""Largest difference of evo's APE from that of the drift model."""

Part = Callable[[Settings, Say], list[Figure]]


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return the figures of all programs."""
    parts: tuple[Part, ...] = (_motion, _drives, _pictures)
    figures: list[Figure] = []
    for i, part in enumerate(parts):
        figures += part(settings, say_of_part(say, i, len(parts), part.__name__.strip("_")))
    return figures


def _motion(settings: Settings, say: Say) -> list[Figure]:
    imu = run_job("referees.motion.imu", settings, say, turned_deg=TURNED_DEG)
    seeds = QUICK_DRIFTS if settings.quick else DRIFTS
    drift = run_job("referees.motion.odometry_drift", settings, say, seeds=seeds)
    return motion_figures(imu, drift)


def motion_figures(imu: Mapping[str, Any], drift: Mapping[str, float]) -> list[Figure]:
    """Return the figures of GTSAM and evo, with their goals."""
    plain, turned = imu["plain"], imu["turned"]
    ape_share = drift["ape_m"] / drift["expected_m"] - 1
    return [
        figure(
            "gtsam_imu_error",
            "%",
            [plain["end_error_share"] * 100],
            Goal(IMU_PERCENT),
            f"of {plain['way_m']:.0f} m in {plain['seconds']:.0f} s",
        ),
        figure("gtsam_imu_turned", "deg", [plain["turned_deg"]], Goal(TURNED_ERROR_DEG)),
        figure(
            "gtsam_fault_turned",
            "deg",
            [abs(turned["turned_deg"] - TURNED_DEG)],
            Goal(TURNED_ERROR_DEG),
            f"fault: IMU turned by {TURNED_DEG:g} deg, found {turned['turned_deg']:.2f}",
        ),
        figure(
            "evo_drift_ape",
            "%",
            [abs(ape_share) * 100],
            Goal(APE_PERCENT),
            f"APE {drift['ape_m']:.3f} m, as configured {drift['expected_m']:.3f} m",
        ),
    ]


def _drives(settings: Settings, say: Say) -> list[Figure]:
    figures: list[Figure] = []
    for i, (name, job) in enumerate(DRIVES.items()):
        found = run_job(
            "referees.lidar.drive",
            settings,
            say_of_part(say, i, len(DRIVES), name),
            **job,
            way_m=QUICK_WAY_M if settings.quick else WAY_M,
            late_s=LATE_MS / 1000,
        )
        figures += lidar_figures(name, found)
    return figures


def lidar_figures(name: str, found: Mapping[str, Any]) -> list[Figure]:
    """Return the figures of KISS-ICP on a drive, with their goals."""
    start, own = f"kiss_icp_{name}", found["own_motion"]
    late_ms = found["late_offset_s"] * 1000
    drift = {mode: found[mode]["drift_share"] * 100 for mode in ("true_motion", "no_times")}
    return [
        figure(
            f"{start}_drift",
            "%",
            [own["drift_share"] * 100],
            Goal(DRIFT_PERCENT),
            f"of {own['way_m']:.0f} m, {own['scans']} scans; "
            f"yaw rate {found['yaw_rate_deg_s']:.0f} deg/s RMS",
        ),
        figure(
            f"{start}_drift_true_motion",
            "%",
            [drift["true_motion"]],
            Goal(DRIFT_PERCENT),
            "points corrected with the true motion",
        ),
        figure(
            f"{start}_drift_no_times",
            "%",
            [drift["no_times"]],
            Goal(own["drift_share"] * 100, at_least=True),
            "points' times ignored: must be worse",
        ),
        figure(
            f"{start}_fault_no_times",
            "",
            [drift["no_times"] / drift["true_motion"]],
            Goal(WORSE, at_least=True),
            "the same, as a multiple of the drift with the true motion",
        ),
        figure(f"{start}_offset", "ms", [abs(own["time_offset_s"]) * 1000], Goal(OFFSET_MS)),
        figure(
            f"{start}_fault_late",
            "ms",
            [abs(late_ms - LATE_MS)],
            Goal(OFFSET_MS),
            f"fault: stamps {LATE_MS:g} ms late, found {late_ms:.1f}",
        ),
    ]


def _pictures(settings: Settings, say: Say) -> list[Figure]:
    # Imports Open3D, for which other topics need not wait.
    from oaisys_mapping.certificate.perturbations import FOCAL_FACTOR

    qualities = QUICK_QUALITIES if settings.quick else QUALITIES
    rows, columns = QUICK_GRID if settings.quick else GRID
    count = QUICK_FLIGHT_PICTURES if settings.quick else FLIGHT_PICTURES
    figures: list[Figure] = []
    for i, quality in enumerate(qualities):
        job: dict[str, Any] = {"quality": quality, "seed": SEED}
        part = say_of_part(say, i, len(qualities), quality)
        grid: dict[str, Any] = {"rows": rows, "columns": columns, "wrong_focal": FOCAL_FACTOR}
        figures += survey_figures(
            quality,
            run_job("referees.pictures.survey", settings, part, **job, **grid),
            wrong_focal=FOCAL_FACTOR,
        )
        figures += _flight_figures(
            quality, run_job("referees.pictures.flight", settings, part, **job, pictures=count)
        )
        figures += _stereo_figures(
            quality, run_job("referees.pictures.stereo", settings, part, **job)
        )
    return figures


def survey_figures(
    quality: str, found: Mapping[str, Mapping[str, Any]], *, wrong_focal: float
) -> list[Figure]:
    """Return the figures of a survey, with their goals.

    Args:
        quality: Preset of its pictures.
        found: Figures with K given (``known``), sought (``unknown``), and given ``wrong``.
        wrong_focal: Factor on the focal length of the K that is ``wrong``.
    """
    known, unknown, wrong = (found[name] for name in ("known", "unknown", "wrong"))
    start = f"colmap_{quality}"
    against_wrong = abs((1 + unknown["focal_share"]) / wrong_focal - 1)
    return [
        _missing(f"{start}_known_missing", known),
        figure(
            f"{start}_known_position",
            "px",
            [known["position_rms_px"]],
            Goal(KNOWN_PX),
            f"RMS, on the ground; {known['position_rms_m'] * 100:.1f} cm",
        ),
        figure(f"{start}_known_reprojection", "px", [known["reprojection_px"]]),
        figure(f"{start}_known_rotation", "deg", [known["rotation_median_deg"]]),
        figure(f"{start}_points", "", [known["points"]], None, "with K given"),
        _missing(f"{start}_unknown_missing", unknown),
        figure(
            f"{start}_unknown_position", "px", [unknown["position_rms_px"]], Goal(UNKNOWN_PX), "RMS"
        ),
        figure(
            f"{start}_unknown_focal",
            "%",
            [abs(unknown["focal_share"]) * 100],
            Goal(FOCAL_PERCENT),
            "error of the focal length",
        ),
        figure(f"{start}_unknown_principal", "px", [unknown["principal_px"]], Goal(PRINCIPAL_PX)),
        figure(
            f"{start}_fault_focal",
            "%",
            [against_wrong * 100],
            Goal(FOCAL_PERCENT, at_least=True),
            f"fault: K says {wrong_focal:g} times the focal length; difference from what is found",
        ),
        figure(
            f"{start}_fault_position",
            "px",
            [wrong["position_rms_px"]],
            Goal(UNKNOWN_PX, at_least=True),
            f"the same K, given; {wrong['registered']} of {wrong['pictures']} registered",
        ),
    ]


def _missing(name: str, found: Mapping[str, Any]) -> Figure:
    return figure(
        name, "", [found["pictures"] - found["registered"]], Goal(0), f"of {found['pictures']}"
    )


def _flight_figures(quality: str, found: Mapping[str, Any]) -> list[Figure]:
    note = f"median of {found['found']} of {found['pairs']} steps of {found['step_m']:.2f} m"
    return [
        figure(f"rgbd_{quality}_position", "%", [found["error_share"] * 100], None, note),
        figure(f"rgbd_{quality}_rotation", "deg", [found["error_deg"]], None, note),
    ]


def _stereo_figures(quality: str, found: Mapping[str, float]) -> list[Figure]:
    note = f"median, of {found['found_share'] * 100:.0f} % of the pixels"
    return [
        figure(f"sgbm_{quality}_disparity", "px", [found["median_px"]], None, note),
        figure(f"sgbm_{quality}_within_1_px", "%", [found["within_pixel_share"] * 100]),
    ]
