"""The reference page of the configuration, generated from its schema."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from oaisys_core.config.model import SimulationConfig
from oaisys_core.config.schema import all_models, build_schema

HEAD = """# Configuration

This page lists every key of the YAML file for `--config`. `make schema` generates it from the code
that checks the keys. Keys have defaults unless they are marked *required*; unknown keys are errors.
`oaisys config check FILE` validates a file, `oaisys config show` prints all keys with their values,
and `config/schema.json` is the same reference for editors. [Keys in pictures](looks.md) shows what
some keys do.

Lengths are in metres, angles in degrees. Pixel centres are at integers, as in OpenCV. A *range* is
`[least, most]` or a single number for both; the value is drawn uniformly from it.

## Values that each world draws

In `stage`, `materials`, `assets`, `environment` and `sensors.motion`, a world may draw any value:

* `relief_m: [1, 8]`, at a key that takes a number: a number between both, with both ends; a whole
  one where only those are allowed.
* `preset: [mounds, canyon]`, at a key that takes no list: one of them. `null` and sections may be
  among them: `water: [null, {level_share: 0.2, semantic_id: 30}]`.
* `{choose: [1, 4, 8], weights: [2, 1, 1]}`, anywhere, also for colours, items of lists and whole
  sections: one of them, by weights if there are any.
* `{range: [1, 8]}` is the same as `[1, 8]`, in full.

A list keeps its meaning at keys that take a range, a list, or several numbers. Each value is drawn
from the world's seed and its own path (names stand for places in lists), so that one more draw
changes no other. All values are checked when the file is read; `oaisys config check` also looks for
files, names, and values that do not fit together. `oaisys config show --world 3` prints what the
fourth world has drawn.

`variants` is a list of kinds of worlds, each with the keys of these sections that differ. Label ids
are those of the whole file: an id with two names is refused.

```yaml
variants:
  - {name: hills, weight: 3, stage: {preset: mounds, relief_m: [2, 8]}}
  - {name: flat, stage: {preset: plane}, environment: {haze: {visibility_m: [200, 2000]}}}
```
"""
MAX_PLACES = 5
"""Largest number of places of a section that are listed."""

Schema = Mapping[str, Any]


def reference_text() -> str:
    """Return the content of ``docs/configuration.md``."""
    schema = build_schema()
    places = _places(schema)
    sections = [
        _section(schema if name == SimulationConfig.__name__ else schema["$defs"][name], at)
        for name in all_models(SimulationConfig)
        if (at := places.get(name, []))
    ]
    return "\n".join([HEAD, *sections])


def _places(schema: Schema) -> dict[str, list[str]]:
    """Return the dotted paths of each section; ``[]`` stands for any entry of a list."""
    found: dict[str, list[str]] = {SimulationConfig.__name__: [""]}

    def walk(node: Schema, at: str) -> None:
        for key, value in node.get("properties", {}).items():
            for name, suffix in _references(value):
                path = f"{at}.{key}{suffix}".removeprefix(".")
                found.setdefault(name, []).append(path)
                walk(schema["$defs"][name], path)

    walk(schema, "")
    return found


def _references(node: Schema) -> Iterator[tuple[str, str]]:
    """Yield the sections in the value of a key, with the path from the key to them."""
    if "$ref" in node:
        yield node["$ref"].rpartition("/")[2], ""
    for option in (*node.get("anyOf", ()), *node.get("oneOf", ())):
        yield from _references(option)
    inner = ("[]", node.get("items")), (".*", _mapping_values(node))
    for suffix, value in inner:
        if isinstance(value, Mapping):
            yield from ((name, suffix + rest) for name, rest in _references(value))


def _mapping_values(node: Schema) -> Any:
    """Return the schema of a mapping's values, whose keys may have to match a pattern."""
    return next(iter(node.get("patternProperties", {}).values()), node.get("additionalProperties"))


def _section(node: Schema, places: list[str]) -> str:
    title = f"`{places[0]}`" if places[0] else "The file"
    kind = node.get("properties", {}).get("kind", {}).get("const")
    lines = [f"## {title}" + (f", `kind: {kind}`" if kind else ""), "", node["description"]]
    if len(places) > 1:
        others = [f"`{place}`" for place in places[1:MAX_PLACES]]
        more = len(places) - 1 - len(others)
        if more:
            others.append(f"{more} other places")
        lines += ["", f"The same keys at {', '.join(others)}."]
    lines += ["", "| Key | Value | Default | Meaning |", "|---|---|---|---|"]
    required = node.get("required", ())
    for key, value in node.get("properties", {}).items():
        default = "*required*" if key in required else _default(value)
        cells = (f"`{key}`", _value(value), default, value.get("description", ""))
        lines.append("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _default(node: Schema) -> str:
    if "default" not in node:
        return ""
    text = json.dumps(node["default"], ensure_ascii=False)
    return f"`{text}`" if len(text) <= 60 else "see `oaisys config show`"


def _value(node: Schema) -> str:
    """Return a description of the values of a key."""
    if "const" in node:
        return f"`{node['const']}`"
    if "enum" in node:
        return ", ".join(f"`{value}`" for value in node["enum"])
    options = [*node.get("anyOf", ()), *node.get("oneOf", ())]
    if len(options) > 1 and options[0].get("type") == "number" and _is_pair(options[1]):
        words = [f"range{_limits(options[0])}", *(_value(option) for option in options[2:])]
        return " or ".join(words)
    if options:
        return " or ".join(dict.fromkeys(_value(option) for option in options))
    if "$ref" in node:
        return "section"
    return _type_in_words(node)


def _type_in_words(node: Schema) -> str:
    kind = node.get("type", "any")
    if kind == "array":
        if "prefixItems" in node:
            items = [_value(item) for item in node["prefixItems"]]
            same = len(set(items)) == 1
            return f"{len(items)} times {items[0]}" if same else f"[{', '.join(items)}]"
        return f"list of {_value(node['items'])}" if "items" in node else "list"
    if kind == "object":
        inner = _mapping_values(node)
        return f"mapping to {_value(inner)}" if isinstance(inner, Mapping) else "mapping"
    if kind == "string":
        return {"path": "path", "date-time": "date and time"}.get(node.get("format", ""), "text")
    return f"{kind}{_limits(node)}"


def _is_pair(node: Schema) -> bool:
    return node.get("type") == "array" and node.get("minItems") == node.get("maxItems") == 2


def _limits(node: Schema) -> str:
    if "minimum" in node and "maximum" in node:
        return f" from {_number(node['minimum'])} to {_number(node['maximum'])}"
    signs = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    limits = [f"{sign} {_number(node[key])}" for key, sign in signs.items() if key in node]
    return f" {', '.join(limits)}" if limits else ""


def _number(value: float) -> str:
    return f"{value:g}" if abs(value) < 1e6 else str(value)
