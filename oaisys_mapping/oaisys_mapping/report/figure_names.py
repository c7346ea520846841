"""Names of figures for people: ``rmse_m`` is "RMSE, m"."""

from __future__ import annotations

UNITS = {
    "m": "m",
    "mm": "mm",
    "m2": "m²",
    "m3": "m³",
    "s": "s",
    "deg": "°",
    "px": "pixels",
    "mb": "MB",
    "hz": "Hz",
}
"""Units by the ending of a figure's name."""

WORDS = {
    "rmse": "RMSE",
    "iou": "IoU",
    "ssim": "SSIM",
    "tsdf": "TSDF",
    "rgb": "colour",
    "id": "id",
    "ros": "ROS",
    "p95": "95th percentile",
    "ratio": "share",
}
"""Words that are written in another way."""

WHOLE = {"f_score": "F-score", "f_scores": "F-scores", "max_f_score": "greatest F-score"}
"""Names that do not follow from their words."""


def figure_name(key: str) -> str:
    """Return what a figure's key in ``report.json`` is called in words, with its unit."""
    if key in WHOLE:
        return WHOLE[key]
    *words, last = key.split("_")
    unit = UNITS.get(last) if words else None
    if unit is None:
        words.append(last)
    shown = " ".join(WORDS.get(word, word) for word in words)
    return shown[0].upper() + shown[1:] + (f", {unit}" if unit else "")
