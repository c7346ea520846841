"""What a check finds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from oaisys_core.verification.audit import AuditResult

MAX_FINDINGS = 1000
"""Findings that a report names; the others are only counted."""


@dataclass(frozen=True)
class DatasetFinding:
    """Something that is wrong with a data set.

    Attributes:
        check: Which check found it: ``head``, ``manifest``, ``shard``, ``hash``, ``image``,
            ``legend``, ``camera``, ``split``, ``missing``, ``duplicate``, ``surface`` or
            ``labels``.
        subject: The file, frame or image.
        text: What was found, and what was expected.
    """

    check: str
    subject: str
    text: str


@dataclass
class ShardResult:
    """What was found in the files of a world.

    Attributes:
        splits: The splits that its frames name.
        seeds: The seeds that its frames name.
        prints: By frame id, a hash of all pixels of the frame.
        records: Number of frames.
        images, image_bytes: Number and size of their images.
        scans: Number of lidar scans.
    """

    world: int
    findings: list[DatasetFinding] = field(default_factory=list)
    splits: set[str] = field(default_factory=set)
    seeds: set[int] = field(default_factory=set)
    prints: dict[str, bytes] = field(default_factory=dict)
    records: int = 0
    images: int = 0
    image_bytes: int = 0
    scans: int = 0

    def note(self, check: str, subject: str, text: str) -> None:
        """Add a finding."""
        self.findings.append(DatasetFinding(check, subject, text))


@dataclass(frozen=True)
class CheckReport:
    """The result of a check.

    Attributes:
        place: The data set.
        worlds, frames, images, image_bytes, scans: What was checked.
        failed_worlds: Worlds that could not be made, which is no finding.
        splits: Number of worlds by split.
        rebuilt_worlds: Worlds that were made again to compare images with them.
        points: Random pixels that were compared with the surface of those worlds.
        scan_points: Random points of lidar scans that were compared likewise.
        audited: Compared pixels by sensor and modality.
        notes: What could not be judged.
        findings: The first `MAX_FINDINGS` findings.
        findings_total: Number of findings.
    """

    place: str
    worlds: int
    frames: int
    images: int
    image_bytes: int
    failed_worlds: tuple[int, ...]
    splits: Mapping[str, int]
    rebuilt_worlds: tuple[int, ...]
    points: int
    audited: tuple[AuditResult, ...]
    notes: tuple[str, ...]
    findings: tuple[DatasetFinding, ...] = field(repr=False)
    findings_total: int = 0
    scans: int = 0
    scan_points: int = 0

    @property
    def has_passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings_total

    def as_json(self) -> dict[str, Any]:
        """Return the report as plain data."""
        audited = [{**asdict(each), "wrong_share": each.wrong_share} for each in self.audited]
        return {"passed": self.has_passed, **asdict(self), "audited": audited}
