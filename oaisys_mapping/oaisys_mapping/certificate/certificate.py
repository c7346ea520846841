"""The closure certificate of a world: its views, and how well its map agrees with the truth.

It is a JSON file that can be shipped with a world. It holds all that is needed to render the views
again, the figures with their limits, and the hashes of the files that were measured. A hash over
the content reveals changes; a signature identifies who issued it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import parse_json, read_text
from oaisys_core.files.whole_files import write_whole_text
from oaisys_mapping.certificate.light_audit import LightAudit
from oaisys_mapping.certificate.perturbations import PerturbationResult
from oaisys_mapping.certificate.signature import PrivateKey, sign
from oaisys_mapping.certificate.view_files import views_to_json
from oaisys_mapping.evaluation.metrics import ReconstructionMetrics
from oaisys_mapping.evaluation.thresholds import Criterion, Thresholds
from oaisys_mapping.evaluation.visibility import PosedCamera

CERTIFICATE_FILE = "certificate.json"
FORMAT = "oaisys closure certificate 1"
CLOSED, OPEN = "closed", "open"

LENGTH_TOLERANCE_M = 1e-4
RATIO_TOLERANCE = 1e-3
RELATIVE_TOLERANCE = 1e-2
"""Allowed differences of figures measured again, because machines round differently; lengths and
areas may differ by the relative tolerance too."""

CHUNK_BYTES = 1 << 20


@dataclass(frozen=True)
class CertificateContent:
    """What a certificate states.

    Attributes:
        facts: Facts of the run: seed, hash of the configuration, backend, versions, quality.
        config: The whole configuration.
        views: Cameras and poses of the mapped images.
        max_range_m: Depth beyond which nothing counts as visible.
        sampling_seed: Seed of the measured points.
        metrics: The figures.
        thresholds: Their limits.
        perturbations: Results of the perturbation tests.
        labels: Names of semantic ids.
        files: Measured files by kind (``mesh``, ``truth``).
        versions: Versions of the software that rendered, mapped and measured.
        light: The audit of the renderer's light; None: it was not audited.
    """

    facts: Mapping[str, Any]
    config: Any
    views: Sequence[PosedCamera]
    max_range_m: float
    sampling_seed: int
    metrics: ReconstructionMetrics
    thresholds: Thresholds
    perturbations: Sequence[PerturbationResult]
    labels: Mapping[int, str]
    files: Mapping[str, Path]
    versions: Mapping[str, str]
    light: LightAudit | None = None

    @property
    def criteria(self) -> list[Criterion]:
        """The figures with their limits."""
        return self.thresholds.criteria_of(self.metrics)


def write_certificate(
    path: Path, content: CertificateContent, key: PrivateKey | None = None
) -> dict[str, Any]:
    """Write a certificate, signed if a key is given, and return it as JSON values."""
    values = _json_content(content)
    certificate = {
        "format": FORMAT,
        "sha256": content_sha256(values),
        "signature": sign(canonical(values), key) if key is not None else None,
        "content": values,
    }
    _write(path, certificate)
    return certificate


def sign_certificate(path: Path, certificate: Mapping[str, Any], key: PrivateKey) -> None:
    """Sign a certificate and write it again.

    Raises:
        InvalidInputError: Its content does not match its hash.
    """
    stated, actual = certificate.get("sha256"), content_sha256(certificate["content"])
    if stated != actual:
        raise InvalidInputError("FILE: sha256", stated, f"{actual}: the content was changed")
    _write(path, {**certificate, "signature": sign(canonical(certificate["content"]), key)})


def _write(path: Path, certificate: Mapping[str, Any]) -> None:
    write_whole_text(path, json.dumps(certificate, indent=1, allow_nan=False) + "\n")


def read_certificate(path: Path) -> dict[str, Any]:
    """Return a certificate from its file, unverified.

    Raises:
        InvalidInputError: The file cannot be read, or is not a certificate.
    """
    try:
        certificate = parse_json(read_text(path))
    except (OSError, ValueError) as error:
        raise InvalidInputError("FILE", str(path), f"a certificate as JSON ({error})") from error
    found = certificate.get("format") if isinstance(certificate, dict) else None
    if found != FORMAT:
        raise InvalidInputError("FILE: format", found, FORMAT)
    if not isinstance(certificate.get("content"), dict):
        raise InvalidInputError("FILE: content", certificate.get("content"), "an object")
    return dict(certificate)


def canonical(content: Mapping[str, Any]) -> bytes:
    """Return the canonical JSON of a content, which is hashed and signed."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return text.encode("utf-8")


def content_sha256(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a content as hexadecimal digits."""
    return hashlib.sha256(canonical(content)).hexdigest()


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file as hexadecimal digits."""
    found = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(CHUNK_BYTES):
            found.update(block)
    return found.hexdigest()


def _json_content(content: CertificateContent) -> dict[str, Any]:
    criteria = content.criteria
    values = {
        "issued": datetime.now(UTC).isoformat(timespec="seconds"),
        "verdict": CLOSED if all(one.holds for one in criteria) else OPEN,
        "criteria": [{**asdict(one), "holds": one.holds} for one in criteria],
        "figures": content.metrics.to_dict(),
        "faults": [result.to_dict() for result in content.perturbations],
        "light": None if content.light is None else content.light.to_json(),
        "facts": dict(content.facts),
        "config": content.config,
        "views": views_to_json(content.views),
        "max_range_m": content.max_range_m,
        "sampling_seed": content.sampling_seed,
        "labels": {str(number): name for number, name in sorted(content.labels.items())},
        "files": {
            what: {"name": path.name, "bytes": path.stat().st_size, "sha256": file_sha256(path)}
            for what, path in content.files.items()
        },
        "tolerances": {
            "length_m": LENGTH_TOLERANCE_M,
            "ratio": RATIO_TOLERANCE,
            "relative": RELATIVE_TOLERANCE,
        },
        "versions": dict(content.versions),
    }
    found: dict[str, Any] = json.loads(json.dumps(values, allow_nan=False))
    return found
