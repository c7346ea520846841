"""The closure certificate: its content, and that any change to it is detected."""

import base64
import hashlib
import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from surfaces import colored, down, hills

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import TriangleMesh
from oaisys_mapping.certificate.certificate import (
    CertificateContent,
    read_certificate,
    sign_certificate,
    write_certificate,
)
from oaisys_mapping.certificate.light_audit import read_light_audit
from oaisys_mapping.certificate.perturbations import PerturbationResult
from oaisys_mapping.certificate.signature import read_private_key, read_public_key
from oaisys_mapping.certificate.verification import (
    CheckResult,
    check_content,
    check_file,
    check_limits,
    measure_again,
    measurement_setup,
)
from oaisys_mapping.certificate.view_files import views_from_json
from oaisys_mapping.evaluation.evaluate import evaluate_reconstruction
from oaisys_mapping.evaluation.thresholds import Thresholds, survey_thresholds
from oaisys_mapping.evaluation.truth_io import as_stored, read_truth, write_truth
from oaisys_mapping.mesh_io import read_ply, write_ply

VOXEL_M, RANGE_M, SEED = 0.1, 60.0, 5
CONFIG = {"seed": SEED, "stage": {"extent_m": 12.0}}
CONFIG_SHA256 = hashlib.sha256(b'{"seed":5,"stage":{"extent_m":12.0}}').hexdigest()
FAULTS = [
    PerturbationResult("none", "", {"rmse_m": 0.01}, []),
    PerturbationResult("bad", "", {}, ["it misses"]),
]

RENDERER = {"backend": "blender", "backend_version": "4.5.15"}
LIGHT: list[dict[str, Any]] = [
    {"name": "a", "measured": 1.0, "expected": 1.0, "limit": 0.02, **RENDERER},
    {"name": "b", "measured": 0.504, "expected": 0.5, "limit": 0.01, **RENDERER},
]


def write_light(path: Path, records: Any = LIGHT) -> Path:
    path.write_text(json.dumps(records))
    return path


Change = Callable[[dict[str, Any]], None]


def write_all(folder: Path, max_rmse_m: float = 0.02) -> dict[str, Any]:
    """A map 1 cm above hills, its truth, and their certificate."""
    vertices_m, triangles = hills(6.0)
    labels = np.where(vertices_m[triangles].mean(axis=1)[:, 0] > 0, 1, 2).astype(np.uint16)
    truth = as_stored(TriangleMesh(vertices_m, triangles, labels))
    write_truth(folder / "truth.ply", truth)
    write_ply(folder / "mesh.ply", colored(vertices_m + np.array((0, 0, 0.01)), triangles))
    views = [down(x_m, 0.0, 6.0) for x_m in (-1.0, 1.0)]
    mesh, rng = read_ply(folder / "mesh.ply"), np.random.default_rng(SEED)
    found = evaluate_reconstruction(mesh, truth, views, VOXEL_M, RANGE_M, rng)
    statement = CertificateContent(
        facts={"seed": SEED, "config_sha256": CONFIG_SHA256, **RENDERER},
        config=CONFIG,
        views=views,
        max_range_m=RANGE_M,
        sampling_seed=SEED,
        metrics=found.metrics,
        thresholds=Thresholds(max_rmse_m, min_completion=0.98, min_f_score=0.98),
        perturbations=FAULTS,
        labels={1: "sand", 2: "gravel"},
        files={what: folder / f"{what}.ply" for what in ("mesh", "truth")},
        versions={"numpy": np.__version__},
        light=read_light_audit(write_light(folder / "light.json")),
    )
    return write_certificate(folder / "certificate.json", statement)


@pytest.fixture(scope="module")
def issued(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("issued")
    write_all(folder)
    return folder


def sealed_again(certificate: dict[str, Any]) -> None:
    """Hash the content anew, as a forger would, by what the format says."""
    text = json.dumps(certificate["content"], sort_keys=True, separators=(",", ":"))
    certificate["sha256"] = hashlib.sha256(text.encode()).hexdigest()


def failed(findings: list[CheckResult]) -> list[str]:
    return [finding.what for finding in findings if finding.holds is False]


def test_a_true_certificate_holds(issued: Path) -> None:
    certificate = read_certificate(issued / "certificate.json")
    content = certificate["content"]
    assert content["verdict"] == "closed"
    assert 0.008 < content["figures"]["rmse_m"] < 0.01, "a shift of 1 cm, across slopes"
    assert content["files"]["mesh"]["sha256"] == sha256_of(issued / "mesh.ply")
    assert not failed(check_content(certificate))
    assert all(check_file(content, w, issued / f"{w}.ply").holds for w in ("mesh", "truth"))
    truth = read_truth(issued / "truth.ply")
    again = measure_again(content, read_ply(issued / "mesh.ply"), truth)
    assert len(again) > 10
    assert not failed(again)
    said = [str(each) for each in check_content(certificate)]
    assert any("2 figures, worst b: +0.80%; measured by `oaisys audit --light" in s for s in said)


def sha256_of(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda content: content["facts"].update(seed=6), "content"),
        (lambda content: content["figures"].update(rmse_m=0.001), "content"),
        (lambda content: content["views"].pop(), "content"),
        (lambda content: content.update(verdict="open"), "verdict"),
        (lambda content: content["config"].update(seed=7), "configuration"),
        (lambda content: content["criteria"].pop(0), "a limit on rmse_m"),
        (lambda content: content["criteria"][0].update(value=0.001), "rmse_m"),
        (lambda content: content["criteria"][0].update(limit=0.001), "rmse_m"),
        (lambda content: content["faults"][1].update(rejected=False), "fault bad"),
        (lambda content: content["light"]["figures"][0].update(measured=1.03), "light: a: +3.00%"),
        (lambda content: content["light"]["figures"][0].update(limit=0.2), "light: a: +0.00%"),
        (lambda content: content["light"].update(backend="analytic"), "light of analytic 4.5.15"),
    ],
)
def test_changes_to_a_certificate_are_detected(issued: Path, change: Change, words: str) -> None:
    certificate = read_certificate(issued / "certificate.json")
    change(certificate["content"])
    found = failed(check_content(certificate))
    assert any("content" in what for what in found), "the hash"
    if words != "content":
        sealed_again(certificate)
        assert any(words in what for what in failed(check_content(certificate)))


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (lambda content: content["figures"].update(rmse_m=0.004), "rmse_m"),
        (lambda content: content["figures"].update(completion_ratio=0.9), "completion_ratio"),
        (lambda content: content["views"].pop(), "surveyed_area_m2"),
    ],
)
def test_figures_that_differ_from_a_second_measurement_are_reported(
    issued: Path, change: Change, name: str
) -> None:
    content = read_certificate(issued / "certificate.json")["content"]
    change(content)
    truth = read_truth(issued / "truth.ply")
    found = failed(measure_again(content, read_ply(issued / "mesh.ply"), truth))
    assert any(what.startswith(name) for what in found)


def test_a_certificate_with_missed_thresholds_says_open(tmp_path: Path) -> None:
    certificate = write_all(tmp_path, max_rmse_m=0.005)
    assert certificate["content"]["verdict"] == "open"
    (missed,) = failed(check_content(certificate))
    assert "rmse_m" in missed


def limits_of(**criteria: tuple[float | None, float, bool]) -> dict[str, Any]:
    """Return a content with figures, each with its limit, or None for no limit."""
    figures = {name: value for name, (_, value, _) in criteria.items()}
    asked = [
        {"name": name, "value": value, "limit": limit, "is_upper": is_upper}
        for name, (limit, value, is_upper) in criteria.items()
        if limit is not None
    ]
    facts = {"command": "oaisys survey --out here"}
    return {"figures": {**figures, "voxel_size_m": 0.1}, "criteria": asked, "facts": facts}


@pytest.mark.parametrize(
    ("name", "criterion", "is_loosened"),
    [
        ("rmse_m", (0.03, 0.01, True), False),
        ("rmse_m", (0.02, 0.01, True), False),
        ("rmse_m", (0.031, 0.01, True), True),
        ("rmse_m", (0.02, 0.01, False), True),
        ("completion_ratio", (0.97, 0.99, False), True),
        ("completion_ratio", (0.98, 0.99, False), False),
        ("overlap_hole_count", (1.0, 0.0, True), True),
        ("least_iou", (0.5, 0.95, False), True),
        ("least_iou", (None, 0.95, False), False),
        ("least_iou", (None, 0.85, False), True),
        ("least_iou", (None, None, False), False),
        ("offset_m", (float("nan"), 0.0, True), True),
    ],
)
def test_loosened_limits_are_shown_and_refused(
    name: str, criterion: tuple[float | None, float, bool], is_loosened: bool
) -> None:
    content = limits_of(**{name: criterion})
    (found,) = check_limits(content)
    assert found.holds is not is_loosened
    assert ("LOOSENED" in found.what) == is_loosened
    (allowed,) = check_limits(content, allow_loosened=True)
    assert allowed.what == found.what
    assert allowed.holds is (None if is_loosened else True)


def test_an_exploration_has_limits_of_its_own() -> None:
    content = limits_of(rmse_m=(0.05, 0.04, True))
    assert check_limits(content)[0].holds is False
    content["facts"]["command"] = "oaisys explore --out there"
    assert check_limits(content)[0].holds


def test_a_map_that_confuses_classes_does_not_close() -> None:
    figures = {"rmse_m": 0.005, "completion_ratio": 1.0, "least_iou": 0.89}
    missed = [
        one.name for one in survey_thresholds(0.1).criteria_of_figures(figures) if not one.holds
    ]
    assert missed == ["least_iou"]
    unlabelled = {**figures, "least_iou": None}
    assert all(one.holds for one in survey_thresholds(0.1).criteria_of_figures(unlabelled))


def test_signatures_are_those_of_openssl(issued: Path, tmp_path: Path) -> None:
    """The key is made, and the signature verified, by another program."""
    key, public = tmp_path / "key.pem", tmp_path / "public.pem"
    openssl("genpkey", "-algorithm", "ed25519", "-out", str(key))
    openssl("pkey", "-in", str(key), "-pubout", "-out", str(public))
    path = tmp_path / "certificate.json"
    sign_certificate(path, read_certificate(issued / "certificate.json"), read_private_key(key))
    certificate = read_certificate(path)
    assert not failed(check_content(certificate, read_public_key(public)))
    message, signature = tmp_path / "message", tmp_path / "signature"
    text = json.dumps(certificate["content"], sort_keys=True, separators=(",", ":"))
    message.write_bytes(text.encode())
    signature.write_bytes(bytes.fromhex(certificate["signature"]["value"]))
    arguments = ("-pubin", "-inkey", str(public), "-rawin", "-in", str(message))
    openssl("pkeyutl", "-verify", *arguments, "-sigfile", str(signature))
    der = base64.b64decode("".join(public.read_text("ascii").splitlines()[1:-1]))
    assert read_public_key(key) == read_public_key(public) == der[-32:].hex()


def openssl(*arguments: str) -> None:
    subprocess.run(["openssl", *arguments], check=True, capture_output=True, timeout=60)


def test_changing_the_content_invalidates_the_signature(issued: Path, tmp_path: Path) -> None:
    keys = [tmp_path / name for name in ("mine.pem", "yours.pem")]
    for key in keys:
        openssl("genpkey", "-algorithm", "ed25519", "-out", str(key))
    path = tmp_path / "certificate.json"
    unsigned = read_certificate(issued / "certificate.json")
    sign_certificate(path, unsigned, read_private_key(keys[0]))
    certificate = read_certificate(path)
    assert any(
        "expected" in w for w in failed(check_content(certificate, read_public_key(keys[1])))
    )
    assert failed(check_content(unsigned, read_public_key(keys[0]))) == ["it is not signed"]
    certificate["content"]["facts"]["quality"] = "final"
    with pytest.raises(InvalidInputError, match="changed"):
        sign_certificate(path, certificate, read_private_key(keys[1]))
    sealed_again(certificate)
    assert failed(check_content(certificate)) == ["the signature"]


def test_a_key_that_is_not_ed25519_is_refused(tmp_path: Path) -> None:
    key = tmp_path / "key.pem"
    openssl("genpkey", "-algorithm", "ed448", "-out", str(key))
    with pytest.raises(InvalidInputError, match="Ed25519"):
        read_private_key(key)
    for read in (read_private_key, read_public_key):
        with pytest.raises(InvalidInputError, match="PEM"):
            read(tmp_path / "nowhere")


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"format": "x"}'])
def test_files_other_than_certificates_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "certificate.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInputError, match="FILE"):
        read_certificate(path)


@pytest.mark.parametrize("part", ["config", "facts", "figures", "criteria"])
def test_a_certificate_with_a_missing_part_is_refused(issued: Path, part: str) -> None:
    certificate = read_certificate(issued / "certificate.json")
    del certificate["content"][part]
    with pytest.raises(InvalidInputError, match="FILE"):
        check_content(certificate)


@pytest.mark.parametrize("part", ["figures", "views", "labels", "sampling_seed"])
def test_a_certificate_that_cannot_be_measured_again_is_refused(issued: Path, part: str) -> None:
    content = read_certificate(issued / "certificate.json")["content"]
    del content[part]
    mesh, truth = read_ply(issued / "mesh.ply"), read_truth(issued / "truth.ply")
    with pytest.raises(InvalidInputError, match="FILE"):
        measure_again(content, mesh, truth)


@pytest.mark.parametrize(
    "damaged",
    [
        *({"sampling_seed": seed} for seed in (float("inf"), -1, "9" * 5000)),
        *({"max_range_m": range_m} for range_m in (0.0, -5.0, float("nan"), "far", None)),
        *({"figures": figures} for figures in ({}, {"voxel_size_m": 0}, {"voxel_size_m": [0.1]})),
        {"views": "none"},
    ],
    ids=str,
)
def test_damaged_numbers_of_a_measurement_are_refused(
    issued: Path, damaged: dict[str, object]
) -> None:
    content = read_certificate(issued / "certificate.json")["content"]
    assert measurement_setup(content).seed == SEED
    with pytest.raises(InvalidInputError, match="FILE"):
        measurement_setup(content | damaged)


def test_a_view_of_infinite_width_is_refused(issued: Path) -> None:
    view = read_certificate(issued / "certificate.json")["content"]["views"][0]
    with pytest.raises(InvalidInputError, match=r"views\.0.*width_px"):
        views_from_json([view | {"width_px": float("inf")}], "views")


def test_a_true_mesh_round_trips_with_its_labels(issued: Path, tmp_path: Path) -> None:
    truth = read_truth(issued / "truth.ply")
    assert truth.semantic_ids is not None
    assert np.unique(truth.semantic_ids).tolist() == [1, 2]
    ids = np.arange(len(truth.triangles), dtype=np.uint32)
    labelled = TriangleMesh(truth.vertices_m, truth.triangles, truth.semantic_ids, ids)
    path = tmp_path / "truth.ply"
    write_truth(path, labelled)
    back = read_truth(path)
    assert np.array_equal(back.vertices_m, truth.vertices_m)
    assert np.array_equal(back.triangles, truth.triangles)
    assert back.semantic_ids is not None
    assert back.instance_ids is not None
    assert np.array_equal(back.semantic_ids, truth.semantic_ids)
    assert np.array_equal(back.instance_ids, ids)
    plain = read_ply(path)
    assert np.array_equal(plain.triangles, truth.triangles), "Open3D reads it, too"
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(InvalidInputError, match="truncated"):
        read_truth(path)


@pytest.mark.parametrize(
    "records",
    [
        {},
        [],
        [{**LIGHT[0], "measured": None}],
        [{**LIGHT[0], "expected": 0}],
        [{"name": "a", "measured": 1.0, "expected": 1.0, "limit": 0.01}],
        [LIGHT[0], {**LIGHT[1], "backend_version": "5.2.3"}],
        "figures",
    ],
)
def test_other_files_are_no_audit_of_light(tmp_path: Path, records: Any) -> None:
    with pytest.raises(InvalidInputError, match="--light"):
        read_light_audit(write_light(tmp_path / "light.json", records))
    with pytest.raises(InvalidInputError, match="--light"):
        read_light_audit(tmp_path / "missing.json")
