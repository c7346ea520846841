"""The report's tables of deliberate faults, classes, completeness and the certificate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from oaisys_mapping.certificate.certificate import CERTIFICATE_FILE
from oaisys_mapping.certificate.light_audit import light_from_json
from oaisys_mapping.certificate.perturbations import PerturbationResult
from oaisys_mapping.evaluation.metrics import ReconstructionMetrics
from oaisys_mapping.report.report import ReportTable
from oaisys_ros_bridge.experiments.evaluation.map_evaluation import MapEvaluation

NOT_MEASURED = "–"


def tables_of(result: MapEvaluation) -> list[ReportTable]:
    """Return the tables for which there are figures."""
    metrics = result.evaluation.metrics
    tables = [_fault_table(result.faults)] if result.faults else []
    if metrics.classes is not None and metrics.classes.iou:
        tables.append(_class_table(metrics))
    tables += [_completeness_table(metrics), *_light_table(result.certificate["content"])]
    return [*tables, _certificate_table(result.certificate)]


def _fault_table(faults: Sequence[PerturbationResult]) -> ReportTable:
    header = ("fault", "RMSE", "median", "offset", "completion")
    rows = [
        (
            record.what,
            _mm(record.figures.get("rmse_m")),
            _mm(record.figures.get("accuracy_median_m")),
            _mm(record.figures.get("offset_m")),
            _percent(record.figures.get("completion_ratio")),
            _number(record.figures.get("f_score")),
            _count(record.figures.get("overlap_hole_count")),
            "rejected" if record.is_rejected else "accepted",
        )
        for record in faults
    ]
    return ReportTable(
        "Deliberate faults",
        "The verdicts on maps of the same frames with a deliberate fault. All rows but the first "
        "must be rejected.",
        (*header, "F-score", "holes in the overlap", "verdict"),
        rows,
    )


def _class_table(metrics: ReconstructionMetrics) -> ReportTable:
    assert metrics.classes is not None
    rows = [
        (name, _percent(metrics.classes.share[name]), f"{iou:.3f}")
        for name, iou in metrics.classes.iou.items()
    ]
    note = "Intersection over union of the map's labels with those of the visible truth."
    return ReportTable("Classes", note, ("class", "share of the surface", "IoU"), rows)


def _completeness_table(metrics: ReconstructionMetrics) -> ReportTable:
    tsdf = metrics.tsdf
    rows = [
        ("share of the truth", _percent(metrics.visible_share), "100 %"),
        *(
            (what, _percent(of_visible), _percent(of_all))
            for what, of_visible, of_all in (
                ("within one voxel", metrics.completion_ratio, metrics.completion_ratio_all),
                ("within two voxels", metrics.completion_ratio_2, metrics.completion_ratio_2_all),
                ("no surface along the normal", metrics.gap_ratio, metrics.gap_ratio_all),
                (
                    "distance unknown",
                    tsdf.unknown_share if tsdf else None,
                    tsdf.unknown_share_all if tsdf else None,
                ),
            )
        ),
        ("mean distance", _mm(metrics.completion_mean_m), _mm(metrics.completion_mean_all_m)),
        ("Chamfer distance", _mm(metrics.chamfer_m), _mm(metrics.chamfer_all_m)),
        ("F-score", _number(metrics.f_score), _number(metrics.f_score_all)),
    ]
    return ReportTable(
        "Completeness",
        "Of the surface that is visible from the poses, which depends on the mapper, and of the "
        "whole true surface, buried parts of objects included, which also depends on the planner.",
        ("", "visible truth", "all truth"),
        rows,
    )


def _light_table(content: Mapping[str, Any]) -> list[ReportTable]:
    """Return the table of the audit of light, if the certificate carries one."""
    if content["light"] is None:
        return []
    audit = light_from_json(content["light"], "light")
    rows = [
        (f.name, f"{f.measured:.5g}", f"{f.expected:.5g}", f"{f.error:+.3%}", f"{f.limit:.0%}")
        for f in audit.figures
    ]
    note = f"Of {audit.backend} {audit.backend_version}, by `{audit.command}`."
    return [ReportTable("Light", note, ("", "measured", "formula", "error", "limit"), rows)]


def _certificate_table(certificate: Mapping[str, Any]) -> ReportTable:
    content, signature = certificate["content"], certificate["signature"]
    rows = [
        ("verdict", content["verdict"]),
        ("SHA-256 of its content", certificate["sha256"]),
        ("signed by", signature["public_key"] if signature else "nobody"),
        *((f"SHA-256 of {one['name']}", one["sha256"]) for one in content["files"].values()),
    ]
    note = f"{CERTIFICATE_FILE} can be checked by `oaisys certificate check`."
    return ReportTable("Certificate", note, ("", ""), rows)


def _mm(value: float | None) -> str:
    return NOT_MEASURED if value is None else f"{1000 * value:.1f} mm"


def _percent(value: float | None) -> str:
    return NOT_MEASURED if value is None else f"{100 * value:.2f} %"


def _number(value: float | None) -> str:
    return NOT_MEASURED if value is None else f"{value:.4f}"


def _count(value: float | None) -> str:
    return NOT_MEASURED if value is None else f"{value:.0f}"
