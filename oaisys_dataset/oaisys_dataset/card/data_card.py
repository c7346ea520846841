"""data_card.html: one page on a data set, for people, with everything in the file itself."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING

from oaisys_dataset.card.pictures import UNLABELLED, label_color, sheet
from oaisys_dataset.card.statistics import number_of

if TYPE_CHECKING:
    from oaisys_dataset.card.statistics import DatasetStatistics, Histogram
    from oaisys_dataset.reader import DatasetSample

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1000px; margin: 2rem auto; padding: 0 1rem;
       color: #222; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.1rem; margin-top: 2rem; }
table { border-collapse: collapse; } td, th { padding: .2rem .8rem .2rem 0; text-align: left; }
td.number { text-align: right; font-variant-numeric: tabular-nums; }
img { max-width: 100%; } .swatch { display: inline-block; width: 1em; height: 1em; }
rect { fill: #47729e; } text { font-size: 11px; fill: #444; }
"""

WIDTH_PX, HEIGHT_PX, FOOT_PX = 640, 120, 18
TICKS = 8


def data_card(
    name: str,
    statistics: DatasetStatistics,
    samples: Sequence[DatasetSample],
    label_ids: Mapping[str, int],
    license_name: str,
    price_per_hour: float | None,
) -> str:
    """Return the HTML page.

    Args:
        name: Name of the format.
        statistics: Of the data set.
        samples: Frames to show.
        label_ids: Id by label.
        license_name: Licence of the data set; empty if the owner gave none.
        price_per_hour: Price of one worker for an hour; None if it is not known.
    """
    picture = base64.b64encode(sheet(samples)).decode("ascii")
    sections = [
        f"<h1>Terrain data set ({escape(name)})</h1>",
        _table(_facts(statistics, license_name, price_per_hour)),
        (
            "<h2>Frames</h2>"
            f'<img alt="{len(samples)} frames as colour, depth and labels" '
            f'src="data:image/jpeg;base64,{picture}">'
        ),
        "<h2>Classes</h2>",
        _classes(statistics, label_ids),
        "<h2>Depth</h2>",
        _depth(statistics),
        "<h2>Sun</h2>",
        _sun(statistics),
        "<h2>Software</h2>",
        _table(list(statistics.software.items())),
    ]
    head = f"<title>Data card ({escape(name)})</title><style>{STYLE}</style>"
    body = "\n".join(sections)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">{head}</head>\n'
        f"<body>\n{body}\n</body></html>\n"
    )


def _facts(
    statistics: DatasetStatistics, license_name: str, price_per_hour: float | None
) -> list[tuple[str, str]]:
    total = sum(statistics.frames.values())
    hours = statistics.seconds / 3600
    facts = [
        ("Licence", license_name or "none given"),
        ("Frames", f"{total} from {number_of(sum(statistics.worlds.values()), 'world')}"),
        *(
            (
                f"Split {split}",
                f"{number_of(count, 'frame')} from {number_of(statistics.worlds[split], 'world')}",
            )
            for split, count in statistics.frames.items()
        ),
        ("Cameras", _count_in_words(statistics.sensors)),
        ("Image sizes", _count_in_words(statistics.sizes)),
        ("Images", _count_in_words(statistics.modalities)),
        *([("Lidar scans", _count_in_words(statistics.scans))] if statistics.scans else []),
        (
            "Rendering",
            f"{statistics.seconds:.0f} s of {statistics.workers} workers, "
            + (f"{statistics.seconds / total:.2f} s a frame, " if total else "")
            + f"{hours:.3g} worker-hours",
        ),
    ]
    if price_per_hour is None:
        return [*facts, ("Cost", "no price was given (--price-per-hour)")]
    cost = hours * price_per_hour
    each = f"; {1000 * cost / total:.4g} for 1000 frames" if total else ""
    return [*facts, ("Cost", f"{cost:.4g} at {price_per_hour:g} an hour{each}")]


def _classes(statistics: DatasetStatistics, label_ids: Mapping[str, int]) -> str:
    rows = []
    for label, share in statistics.class_shares.items():
        red, green, blue = label_color(label_ids.get(label, 0)) if label else UNLABELLED
        swatch = f'<span class="swatch" style="background: rgb({red},{green},{blue})"></span>'
        rows.append(
            f"<tr><td>{swatch} {escape(label or 'unlabelled')}</td>"
            f'<td class="number">{100 * share:.2f} %</td>'
            f'<td class="number">{statistics.objects.get(label, "")}</td></tr>'
        )
    mean = statistics.objects_per_frame
    seen = (
        ""
        if mean is None
        else f"<p>A frame shows {mean:.1f} objects on average ({statistics.sampled} frames).</p>"
    )
    return (
        f"<table><tr><th>label</th><th>share of pixels</th><th>objects</th></tr>{''.join(rows)}"
        f"</table>{seen}"
    )


def _depth(statistics: DatasetStatistics) -> str:
    if statistics.depth_m is None:
        return "<p>No depth.</p>"
    chart = _chart(statistics.depth_m, "m")
    share = 100 * statistics.no_hit_share
    told = f"Of the pixels of {statistics.sampled} frames that hit something; {share:.2f} % hit"
    return f"{chart}<p>{told} nothing.</p>"


def _sun(statistics: DatasetStatistics) -> str:
    if statistics.sun_deg is None:
        return "<p>The frames do not say where the sun is.</p>"
    return f"{_chart(statistics.sun_deg, '°')}<p>Elevation of the sun, by frame.</p>"


def _chart(histogram: Histogram, unit: str) -> str:
    """Return a histogram as SVG; its bins have equal widths, whatever their bounds."""
    bins = len(histogram.shares)
    used = [i for i, share in enumerate(histogram.shares) if share] or [0]
    first, last = max(used[0] - 1, 0), min(used[-1] + 2, bins)
    step = WIDTH_PX / (last - first)
    most = max(float(max(histogram.shares)), 1e-9)
    parts = []
    for place, share in enumerate(histogram.shares[first:last]):
        height = HEIGHT_PX * float(share) / most
        parts.append(
            f'<rect x="{place * step:.1f}" y="{HEIGHT_PX - height:.1f}" width="{step - 1:.1f}" '
            f'height="{height:.1f}"><title>{100 * share:.2f} %</title></rect>'
        )
    every = max(1, (last - first) // TICKS)
    for place in range(0, last - first, every):
        text = f"{histogram.edges[first + place]:.3g} {unit}"
        parts.append(f'<text x="{place * step:.1f}" y="{HEIGHT_PX + 14}">{text}</text>')
    return (
        f'<svg viewBox="0 0 {WIDTH_PX + 40} {HEIGHT_PX + FOOT_PX}" role="img">'
        f"{''.join(parts)}</svg>"
    )


def _table(rows: Sequence[tuple[str, str]]) -> str:
    cells = "".join(
        f"<tr><th>{escape(str(name))}</th><td>{escape(str(value))}</td></tr>"
        for name, value in rows
    )
    return f"<table>{cells}</table>"


def _count_in_words(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} ({count})" for name, count in counts.items())
