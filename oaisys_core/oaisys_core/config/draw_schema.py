"""The part of the JSON Schema that lets worlds draw their values."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from oaisys_core.config.draws import CHOOSE, MOTION, RANGE, WEIGHTS, WORLD
from oaisys_core.config.section import LEAST_WEIGHT, MOST_WEIGHT

Schema = dict[str, Any]

_WEIGHT = {"type": "number", "minimum": LEAST_WEIGHT, "maximum": MOST_WEIGHT}
_OPTIONS = {"type": "array", "minItems": 1}
_DRAWS: dict[str, Schema] = {
    "WrittenDraw": {
        "description": "A value that each world draws.",
        "type": "object",
        "properties": {
            RANGE: {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
            CHOOSE: _OPTIONS,
            WEIGHTS: {"type": "array", "items": _WEIGHT},
        },
        "oneOf": [{"required": [RANGE]}, {"required": [CHOOSE]}],
        "additionalProperties": False,
    },
    "Draw": {
        "description": "A value that each world draws: [least, most], or a list to choose from.",
        "anyOf": [_OPTIONS, {"$ref": "#/$defs/WrittenDraw"}],
    },
}


def allow_draws(schema: Schema) -> Schema:
    """Return the schema of a configuration with draws in all that belongs to a world."""
    definitions = schema["$defs"]
    roots = [schema["properties"][name] for name in WORLD]
    _, motion = MOTION
    sensors = definitions["SensorsConfig"]["properties"]
    roots.append(sensors[motion])
    names: set[str] = set()
    for root in roots:
        names.update(_names_below(root, definitions, names))
    for name in names:
        properties = definitions[name].get("properties", {})
        for key, node in properties.items():
            properties[key] = _with_draw(node)
    for name in WORLD:
        schema["properties"][name] = _with_draw(schema["properties"][name])
    sensors[motion] = _with_draw(sensors[motion])
    return {**schema, "$defs": {**definitions, **_DRAWS}}


def _with_draw(node: Schema) -> Schema:
    """Return the schema of a value that may be drawn, and so may its parts."""
    if "const" in node:
        return node  # the kind of a section, which decides about its other keys
    about: Schema = {key: node[key] for key in ("description", "default") if key in node}
    value = _inside({key: each for key, each in node.items() if key not in about})
    draw = "WrittenDraw" if any(_arrays(node)) else "Draw"
    return {"anyOf": [value, {"$ref": f"#/$defs/{draw}"}], **about}


def _inside(node: Schema) -> Schema:
    """Return the schema of a value with draws in its items."""
    changed = dict(node)
    if isinstance(node.get("items"), dict):
        changed["items"] = _with_draw(node["items"])
    if "prefixItems" in node:
        changed["prefixItems"] = [_with_draw(each) for each in node["prefixItems"]]
    if "anyOf" in node:
        changed["anyOf"] = [_inside(each) for each in node["anyOf"]]
    return changed


def _arrays(node: Schema) -> Iterator[Schema]:
    """Yield the lists that a value may be."""
    if node.get("type") == "array":
        yield node
    for option in (*node.get("anyOf", ()), *node.get("oneOf", ())):
        yield from _arrays(option)


def _names_below(node: Any, definitions: Schema, known: set[str]) -> set[str]:
    """Return the names of the sections in a schema, at any depth."""
    found: set[str] = set()
    if isinstance(node, dict):
        name = str(node.get("$ref", "")).rpartition("/")[2]
        if name and name not in known:
            found |= {name}
            found |= _names_below(definitions[name], definitions, known | found)
        for value in node.values():
            found |= _names_below(value, definitions, known | found)
    elif isinstance(node, list):
        for value in node:
            found |= _names_below(value, definitions, known | found)
    return found
