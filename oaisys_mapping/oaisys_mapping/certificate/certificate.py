"""The closure certificate: what world was seen from where, and that its map agrees with it.

A JSON file that a world can ship. It says how to make the world and the views again, holds the
figures with the limits they were held against, and names the files they were taken from by hash.
A hash over all of it shows that it was changed; a signature, who vouches for it.
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
from oaisys_mapping.certificate.perturbations import PerturbationResult
from oaisys_mapping.certificate.signature import PrivateKey, signed
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
"""Figures that are measured again may differ by so much, lengths and areas by the relative
tolerance too: other machines round otherwise."""

BLOCK_BYTES = 1 << 20


@dataclass(frozen=True)
class CertificateContent:
    """What a certificate says.

    Attributes:
        facts: Of the run: seed, hash of the configuration, backend, versions, quality.
        config: The whole configuration.
        views: Cameras and their poses, as the mapper took them.
        max_range_m: Depth beyond which nothing counts as visible.
        sampling_seed: Draws the points that were measured.
        metrics: The figures.
        thresholds: What they were held against.
        faults: Maps with deliberate faults, told beside it.
        labels: Names of semantic ids.
        files: By what they are (``mesh``, ``truth``).
        versions: Of what rendered, mapped and measured.
    """

    facts: Mapping[str, Any]
    config: Any
    views: Sequence[PosedCamera]
    max_range_m: float
    sampling_seed: int
    metrics: ReconstructionMetrics
    thresholds: Thresholds
    faults: Sequence[PerturbationResult]
    labels: Mapping[int, str]
    files: Mapping[str, Path]
    versions: Mapping[str, str]

    @property
    def criteria(self) -> list[Criterion]:
        """The figures against their limits."""
        return self.thresholds.applied_to(self.metrics)


def write_certificate(
    path: Path, statement: CertificateContent, key: PrivateKey | None = None
) -> dict[str, Any]:
    """Write a certificate, signed where a key is given, and return it."""
    content = _content(statement)
    certificate = {
        "format": FORMAT,
        "sha256": content_sha256(content),
        "signature": signed(canonical(content), key) if key is not None else None,
        "content": content,
    }
    _write(path, certificate)
    return certificate


def sign_certificate(path: Path, certificate: Mapping[str, Any], key: PrivateKey) -> None:
    """Write a certificate anew, signed.

    Raises:
        InvalidInputError: Its content is not the one that its hash is of.
    """
    said, found = certificate.get("sha256"), content_sha256(certificate["content"])
    if said != found:
        raise InvalidInputError("FILE: sha256", said, f"{found}: the content was changed")
    _write(path, {**certificate, "signature": signed(canonical(certificate["content"]), key)})


def _write(path: Path, certificate: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(certificate, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_certificate(path: Path) -> dict[str, Any]:
    """Return a certificate as it is in its file, true or not.

    Raises:
        InvalidInputError: The file cannot be read, or is no certificate.
    """
    try:
        certificate = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InvalidInputError("FILE", str(path), f"a certificate as JSON ({error})") from error
    found = certificate.get("format") if isinstance(certificate, dict) else None
    if found != FORMAT:
        raise InvalidInputError("FILE: format", found, FORMAT)
    if not isinstance(certificate.get("content"), dict):
        raise InvalidInputError("FILE: content", certificate.get("content"), "an object")
    return dict(certificate)


def canonical(content: Mapping[str, Any]) -> bytes:
    """Return the one form of a content that is hashed and signed."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return text.encode("utf-8")


def content_sha256(content: Mapping[str, Any]) -> str:
    """Return the hash of a content."""
    return hashlib.sha256(canonical(content)).hexdigest()


def file_sha256(path: Path) -> str:
    """Return the hash of a file."""
    found = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(BLOCK_BYTES):
            found.update(block)
    return found.hexdigest()


def _content(statement: CertificateContent) -> dict[str, Any]:
    criteria = statement.criteria
    content = {
        "issued": datetime.now(UTC).isoformat(timespec="seconds"),
        "verdict": CLOSED if all(one.holds for one in criteria) else OPEN,
        "criteria": [{**asdict(one), "holds": one.holds} for one in criteria],
        "figures": statement.metrics.to_dict(),
        "faults": [record.to_dict() for record in statement.faults],
        "facts": dict(statement.facts),
        "config": statement.config,
        "views": views_to_json(statement.views),
        "max_range_m": statement.max_range_m,
        "sampling_seed": statement.sampling_seed,
        "labels": {str(number): name for number, name in sorted(statement.labels.items())},
        "files": {
            what: {"name": path.name, "bytes": path.stat().st_size, "sha256": file_sha256(path)}
            for what, path in statement.files.items()
        },
        "tolerances": {
            "length_m": LENGTH_TOLERANCE_M,
            "ratio": RATIO_TOLERANCE,
            "relative": RELATIVE_TOLERANCE,
        },
        "versions": dict(statement.versions),
    }
    found: dict[str, Any] = json.loads(json.dumps(content, allow_nan=False))
    return found
