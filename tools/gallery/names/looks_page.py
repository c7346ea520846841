"""The page of the keys that change a picture, docs/looks.md."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from tools.gallery.names.keys import KEY_PAIRS, PAIRS, KeyPair
from tools.programs import ROOT

PAGE = ROOT / "docs" / "looks.md"

HEAD = """# Keys in pictures

Find the look that you want, and the key that makes it. Each row is one world with two values of
one key; all else is the same.

```yaml
environment: {sun_elevation_deg: 6, haze: {visibility_m: 2000}}
```

[Configuration](configuration.md) has all keys, their ranges and defaults; [names](names.md) shows
terrains, textures, rocks and plants. `make site-pictures` makes this page and its pictures.
"""


def looks_text() -> str:
    """Return the page in Markdown."""
    return "\n".join([HEAD, *_sections()])


def write_looks_page() -> None:
    """Write the page."""
    PAGE.write_text(looks_text(), encoding="utf-8")


def _sections() -> Iterator[str]:
    """Yield a part for each section of the configuration."""
    for title in dict.fromkeys(_title(pair) for pair in KEY_PAIRS):
        yield f"## {title.capitalize()}\n"
        yield "| key | left | right | pictures |\n|---|---|---|---|"
        yield from (_row(pair) for pair in KEY_PAIRS if _title(pair) == title)
        yield ""


def _title(pair: KeyPair) -> str:
    return pair.key.partition(".")[0]


def _row(pair: KeyPair) -> str:
    anchor = "".join(each for each in pair.section if each.isalnum() or each == "_")
    left, right = (f"`{_written(value)}`" for value in pair.values)
    picture = f"![{pair.key}: {pair.note}](pictures/{PAIRS}/{pair.name}.webp)"
    key = f"[`{pair.key}`](configuration.md#{anchor})<br>{pair.note}"
    return f"| {key} | {left} | {right} | {picture} |"


def _written(value: Any) -> str:
    """Return a value as YAML is written."""
    return value if isinstance(value, str) else json.dumps(value)
