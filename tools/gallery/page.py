"""The gallery's page and its image files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import jinja2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import (
    ALBEDO,
    DISTANCES,
    FLOW,
    INSTANCE,
    NORMAL,
    RGB,
    Frame,
    Sample,
    semantic_level,
)
from oaisys_mapping.report import pictures

FLOW_RANGE_PX = 40.0
"""Motion that is drawn with full saturation."""


@dataclass(frozen=True)
class ViewImages:
    """The images of one sensor at one view.

    Attributes:
        files: Image file by modality, relative to the page.
        legend: Colours of the visible labels by name.
        figures: Figures of the picture as text by name.
    """

    title: str
    files: Mapping[str, str]
    legend: Mapping[str, str]
    figures: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Entry:
    """One world of the gallery."""

    group: str
    name: str
    caption: str
    views: list[ViewImages]


def write_view_images(
    out: Path, stem: str, view: str, sample: Sample, labels: Mapping[int, str]
) -> list[ViewImages]:
    """Write all images of a sample and return their entries for the page."""
    views = []
    for sensor in dict.fromkeys(frame.sensor for frame in sample.frames):
        frames = [frame for frame in sample.frames if frame.sensor == sensor]
        files = {}
        for frame in frames:
            suffix = "jpg" if frame.modality in (RGB, ALBEDO) else "png"
            name = f"{stem}_{sensor}_{frame.modality}.{suffix}".replace(" ", "_")
            encode = pictures.jpeg if suffix == "jpg" else pictures.png
            (out / name).write_bytes(encode(picture(frame, labels)))
            files[frame.modality] = name
        title = view if len(frames) == len(sample.frames) else f"{view}, {sensor}"
        views.append(ViewImages(title, files, _legend(frames, labels)))
    return views


def picture(frame: Frame, labels: Mapping[int, str]) -> NDArray[np.uint8]:
    """Return a frame of any modality as a colour image."""
    data = frame.data
    if frame.modality in (RGB, ALBEDO):
        return np.asarray(data, np.uint8)
    if frame.modality in DISTANCES:
        seen = data[np.isfinite(data)]
        near_m, far_m = (seen.min(), np.quantile(seen, 0.98)) if seen.size else (0.0, 1.0)
        return pictures.depth_picture(data, float(near_m), float(far_m))
    if semantic_level(frame.modality) is not None:
        return pictures.semantic_picture(data, labels)
    if frame.modality == INSTANCE:
        return pictures.instance_picture(data)
    if frame.modality == NORMAL:
        return np.asarray(np.rint((data * (1, -1, -1) + 1) * 127.5), np.uint8)
    if frame.modality == FLOW:
        shown = np.clip(np.nan_to_num(data) / FLOW_RANGE_PX, -1, 1) * 127 + 128
        return np.dstack((shown, np.full(data.shape[:2], 128))).astype(np.uint8)
    raise KeyError(frame.modality)


def _legend(frames: list[Frame], labels: Mapping[int, str]) -> dict[str, str]:
    seen: set[int] = set()
    for frame in frames:
        if semantic_level(frame.modality) is not None:
            seen.update(np.unique(frame.data).tolist())
    return {
        labels[i]: "#{:02x}{:02x}{:02x}".format(*pictures.label_color(i, labels).tolist())
        for i in sorted(seen)
        if i in labels
    }


def write_page(out: Path, entries: list[Entry], facts: str) -> Path:
    """Write ``index.html`` and return it."""
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    template = jinja2.Environment(loader=loader, autoescape=True).get_template("page.html.j2")
    groups = list(dict.fromkeys(entry.group for entry in entries))
    page = out / "index.html"
    page.write_text(template.render(groups=groups, entries=entries, facts=facts), encoding="utf-8")
    return page
