"""Verifies a closure certificate: its hash, its signature, its files and its figures."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import TriangleMesh
from oaisys_mapping.certificate.certificate import (
    CLOSED,
    LENGTH_TOLERANCE_M,
    OPEN,
    RATIO_TOLERANCE,
    RELATIVE_TOLERANCE,
    canonical,
    content_sha256,
    file_sha256,
)
from oaisys_mapping.certificate.light_audit import USUAL_LIMIT, light_from_json
from oaisys_mapping.certificate.signature import is_signature_of
from oaisys_mapping.certificate.view_files import views_from_json
from oaisys_mapping.evaluation.evaluate import Extras, evaluate_reconstruction
from oaisys_mapping.evaluation.semantics import ClassField
from oaisys_mapping.evaluation.thresholds import (
    Criterion,
    Thresholds,
    exploration_thresholds,
    survey_thresholds,
)
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.mesh import ColoredMesh

COMPARED = (
    *("accuracy_mean_m", "accuracy_median_m", "rmse_m", "completion_mean_m", "chamfer_m"),
    *("offset_m", "completion_mean_all_m", "completion_ratio", "completion_ratio_2", "precision"),
    *("precision_2", "f_score", "f_score_2", "hole_ratio", "gap_ratio", "overlap_hole_ratio"),
    *("completion_ratio_all", "f_score_all", "visible_share", "surveyed_area_m2"),
)
"""Figures that are measured again; hole counts are left out, as one point can change them."""

REQUIRED = ("rmse_m", "completion_ratio", "f_score")
"""Figures that must have a limit for the verdict to mean anything."""

SURVEY, EXPLORATION = "a survey", "an exploration"

USUAL_THRESHOLDS: Mapping[str, Callable[[float], Thresholds]] = {
    SURVEY: survey_thresholds,
    EXPLORATION: exploration_thresholds,
}
"""The usual thresholds of each kind of experiment, as functions of the voxel size."""


@dataclass(frozen=True)
class CheckResult:
    """The result of one check.

    Attributes:
        what: What was checked, in words.
        holds: Whether it holds; None if it could not be checked.
    """

    what: str
    holds: bool | None

    def __str__(self) -> str:
        word = {True: "ok", False: "FAILED", None: "not checked"}[self.holds]
        return f"{word}: {self.what}"


def check_content(
    certificate: Mapping[str, Any], public_key: str | None = None
) -> list[CheckResult]:
    """Check a certificate's hashes, signature and verdict.

    Args:
        certificate: A certificate from `read_certificate`.
        public_key: Key that must have signed it, as hexadecimal digits; None: any or none.

    Raises:
        InvalidInputError: The certificate is incomplete.
    """
    content = certificate["content"]
    is_whole = certificate.get("sha256") == content_sha256(content)
    results = [
        CheckResult("the hash over the content", is_whole),
        _signature(certificate, public_key),
    ]
    config = hashlib.sha256(canonical(_part(content, "config"))).hexdigest()
    agrees = config == _part(content, "facts").get("config_sha256")
    results.append(CheckResult("the hash of the configuration", agrees))
    return [*results, *_verdict(content), *_light(content)]


def _signature(certificate: Mapping[str, Any], public_key: str | None) -> CheckResult:
    signature = certificate.get("signature")
    if signature is None:
        return CheckResult("it is not signed", None if public_key is None else False)
    if not is_signature_of(signature, canonical(certificate["content"])):
        return CheckResult("the signature", False)
    signer = signature["public_key"]
    if public_key is None:
        return CheckResult(
            f"the signature of {signer}; decide yourself whether to trust this key", True
        )
    return CheckResult(f"signed by {signer}, expected {public_key}", signer == public_key)


def _verdict(content: Mapping[str, Any]) -> list[CheckResult]:
    """Check that the criteria match the figures, and the verdict the criteria."""
    figures = _part(content, "figures")
    criteria = _criteria(content)
    missing = set(REQUIRED) - {one.name for one in criteria}
    results = [CheckResult(f"a limit on {name}", False) for name in sorted(missing)]
    for one in criteria:
        is_same = figures.get(one.name) == one.value
        results.append(CheckResult(f"{one}", is_same and one.holds))
    said = content.get("verdict")
    follows = CLOSED if all(one.holds for one in criteria) else OPEN
    results.append(CheckResult(f"the verdict, {said}, follows from the criteria", said == follows))
    for record in content.get("faults", []):
        is_right = bool(record["rejected"]) == (record["name"] != "none")
        word = "rejected" if record["rejected"] else "not rejected"
        results.append(CheckResult(f"fault {record['name']}: {word}", is_right))
    return results


def _light(content: Mapping[str, Any]) -> list[CheckResult]:
    """Check the audit of the renderer's light, if there is one."""
    values = content.get("light")
    if values is None:
        return [CheckResult("light, which was not audited", None)]
    audit = light_from_json(values, "FILE: light")
    facts = _part(content, "facts")
    rendered_by = (facts.get("backend"), facts.get("backend_version"))
    is_same = rendered_by == (audit.backend, audit.backend_version)
    results = [
        CheckResult(f"light of {audit.backend} {audit.backend_version}, which rendered", is_same)
    ]
    missed = [f for f in audit.figures if not f.is_met or f.limit > USUAL_LIMIT]
    results += [
        CheckResult(f"light: {f.name}: {f.error:+.2%}, limit {f.limit:.0%}", False) for f in missed
    ]
    if not missed:
        worst = audit.worst
        what = f"light: {len(audit.figures)} figures, worst {worst.name}: {worst.error:+.2%}"
        results.append(CheckResult(f"{what}; measured by `{audit.command}`", True))
    return results


def _criteria(content: Mapping[str, Any]) -> list[Criterion]:
    try:
        return [
            Criterion(one["name"], float(one["value"]), float(one["limit"]), one["is_upper"])
            for one in content["criteria"]
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInputError("FILE: criteria", str(error), "name, value, limit") from error


def check_limits(content: Mapping[str, Any], *, allow_loosened: bool = False) -> list[CheckResult]:
    """Compare a certificate's limits with the usual ones.

    A missing limit, as in older certificates, counts as loosened only if the figure does not meet
    the usual limit.

    Args:
        content: The certificate's content.
        allow_loosened: Report loosened limits without failing the check.

    Raises:
        InvalidInputError: The certificate is incomplete.
    """
    figures = _part(content, "figures")
    experiment = _experiment(content)
    try:
        usual = USUAL_THRESHOLDS[experiment](float(figures["voxel_size_m"])).criteria_of_figures(
            figures
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInputError("FILE: figures", str(error), "figures and voxel_size_m") from error
    given = {one.name: one for one in _criteria(content)}
    results = []
    for one in usual:
        own = given.get(one.name)
        if own is not None and own.is_looser_than(one):
            what = f"LOOSENED: {one.name} must be {own.bound}; usual for {experiment}: {one.bound}"
        elif own is None and not one.holds:
            what = f"LOOSENED: {one.name} has no limit; usual for {experiment}: {one}"
        else:
            continue
        results.append(CheckResult(what, None if allow_loosened else False))
    if not results:
        results.append(
            CheckResult(f"the limits are at least as tight as usual for {experiment}", True)
        )
    return results


def _experiment(content: Mapping[str, Any]) -> str:
    """Return the kind of experiment that a certificate is of, by the command that it names."""
    words = str(_part(content, "facts").get("command", "")).split()[:2]
    return EXPLORATION if "explore" in words else SURVEY


def check_file(content: Mapping[str, Any], what: str, path: Path) -> CheckResult:
    """Check that a file has the hash that a certificate gives for its ``mesh`` or ``truth``."""
    said = _part(_part(content, "files"), what)
    return CheckResult(f"the hash of {what} {path}", file_sha256(path) == said.get("sha256"))


class MeasurementSetup(NamedTuple):
    """How a map was measured.

    Attributes:
        voxel_size_m, max_range_m: Of the map.
        seed: Of the measured points.
        views: What was seen.
    """

    voxel_size_m: float
    max_range_m: float
    seed: int
    views: list[PosedCamera]

    def rng(self) -> np.random.Generator:
        """Return what draws the measured points."""
        return np.random.default_rng(self.seed)


def measurement_setup(content: Mapping[str, Any]) -> MeasurementSetup:
    """Return how the map of a certificate's content was measured.

    Raises:
        InvalidInputError: The certificate is incomplete, or a value cannot be.
    """
    try:
        voxel_size_m = float(_part(content, "figures")["voxel_size_m"])
        max_range_m, seed = float(content["max_range_m"]), int(content["sampling_seed"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InvalidInputError("FILE", str(error), "how the map was measured") from error
    for name, value in (("figures.voxel_size_m", voxel_size_m), ("max_range_m", max_range_m)):
        if not 0 < value < np.inf:
            raise InvalidInputError(f"FILE: {name}", value, "a positive, finite number")
    if seed < 0:
        raise InvalidInputError("FILE: sampling_seed", seed, "0 or more")
    views = views_from_json(_part(content, "views"), "FILE: views")
    return MeasurementSetup(voxel_size_m, max_range_m, seed, views)


def measure_again(
    content: Mapping[str, Any],
    mesh: ColoredMesh,
    truth: TriangleMesh,
    classes: ClassField | None = None,
) -> list[CheckResult]:
    """Measure a map again as the certificate was measured, and compare the figures.

    Args:
        content: The certificate's content.
        mesh: The map's surface.
        truth: The true surface.
        classes: The map's classes; without them the IoU is not compared.

    Raises:
        InvalidInputError: The certificate is incomplete, or a mesh is empty.
    """
    figures = _part(content, "figures")
    setup = measurement_setup(content)
    try:
        labels = {int(number): str(name) for number, name in content["labels"].items()}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InvalidInputError("FILE: labels", str(error), "names by their numbers") from error
    extras = Extras(labels=labels, classes=classes)
    found = evaluate_reconstruction(
        mesh, truth, setup.views, setup.voxel_size_m, setup.max_range_m, setup.rng(), extras
    )
    measured = found.metrics.to_dict()
    names = COMPARED if classes is None else (*COMPARED, "least_iou")
    return [
        _compare(name, figures[name], measured.get(name))
        for name in names
        if figures.get(name) is not None
    ]


def _compare(name: str, said: float, found: float | None) -> CheckResult:
    if found is None:
        return CheckResult(f"{name}: {said:.6g} in the certificate, cannot be measured", False)
    allowed = RATIO_TOLERANCE
    if name.endswith(("_m", "_m2")):
        allowed = LENGTH_TOLERANCE_M + RELATIVE_TOLERANCE * abs(said)
    what = f"{name}: {said:.6g} in the certificate, {found:.6g} measured again (± {allowed:.2g})"
    return CheckResult(what, abs(found - said) <= allowed)


def _part(content: Mapping[str, Any], name: str) -> Any:
    if not isinstance(content.get(name), dict | list):
        raise InvalidInputError(f"FILE: {name}", content.get(name), "an object or a list")
    return content[name]
