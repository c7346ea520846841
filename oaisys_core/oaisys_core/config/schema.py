"""The JSON Schema of the configuration; descriptions come from the docstrings of sections."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema

from oaisys_core.config.draw_schema import allow_draws
from oaisys_core.config.model import SimulationConfig

DIALECT = "https://json-schema.org/draft/2020-12/schema"

ENTRY = re.compile(r"(?P<names>[A-Za-z_]\w*(?:, [A-Za-z_]\w*)*): (?P<text>\S.*)")
CODE = re.compile(r"``([^`]+)``")
NONE = re.compile(r"\bNone\b")


def config_schema() -> dict[str, Any]:
    """Return the JSON Schema of configuration files, in which values may be drawn."""
    return allow_draws(build_schema())


def build_schema() -> dict[str, Any]:
    """Return the JSON Schema of values that are not drawn, with a description of each key."""
    schema = SimulationConfig.model_json_schema(schema_generator=_WithoutTitles)
    definitions = schema["$defs"] | {SimulationConfig.__name__: schema}
    for name, model in all_models(SimulationConfig).items():
        definition = definitions[name]
        definition["description"] = summary(model)
        for key, text in descriptions(model).items():
            definition["properties"][key]["description"] = text
            default = model.model_fields[key].default
            if isinstance(default, BaseModel) and default == type(default)():
                del definition["properties"][key]["default"]
    return {"$schema": DIALECT, **schema, "title": "OAISYS configuration"}


def schema_text() -> str:
    """Return the content of ``config/schema.json``."""
    return json.dumps(config_schema(), indent=2, ensure_ascii=False) + "\n"


def summary(model: type[BaseModel]) -> str:
    """Return the docstring of a section up to the first heading, as one line."""
    return _plain(" ".join(_docstring(model).partition("Attributes:")[0].split()))


def descriptions(model: type[BaseModel]) -> dict[str, str]:
    """Return the description of each field that has one.

    The description comes from the docstring of the class, else of its bases, else of the section
    that the field holds. Fields with a single possible value get a generic description.
    """
    written: dict[str, str] = {}
    for kind in reversed(model.__mro__):
        if issubclass(kind, BaseModel):
            written.update(_attributes(_docstring(kind)))
    found = {}
    for name, field in model.model_fields.items():
        if name in written:
            found[name] = written[name]
        elif get_origin(field.annotation) is Literal and len(get_args(field.annotation)) == 1:
            found[name] = f"Selects this section: {_lower(summary(model))}"
        else:
            sections = list(models_in(field.annotation))
            if len(sections) == 1:
                found[name] = summary(sections[0])
    return found


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the sections in a type, at any depth of tuples and unions."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        if part is not Ellipsis:
            yield from models_in(part)


def all_models(root: type[BaseModel]) -> dict[str, type[BaseModel]]:
    """Return a section and all sections below it, by class name, in the order of fields."""
    found: dict[str, type[BaseModel]] = {root.__name__: root}
    for field in root.model_fields.values():
        for model in models_in(field.annotation):
            if model.__name__ not in found:
                found.update({k: v for k, v in all_models(model).items() if k not in found})
    return found


def _docstring(model: type[BaseModel]) -> str:
    """Return the docstring of the class itself; `inspect.getdoc` might return that of a base."""
    return inspect.cleandoc(model.__dict__.get("__doc__") or "")


def _attributes(docstring: str) -> dict[str, str]:
    """Return descriptions by name; several names may share one."""
    found: dict[str, str] = {}
    names: list[str] = []
    for line in docstring.partition("Attributes:\n")[2].splitlines():
        text = line.strip()
        depth = len(line) - len(line.lstrip())
        if text and depth == 0:
            break
        entry = ENTRY.fullmatch(text) if depth <= 4 else None
        if entry is not None:
            names = entry["names"].split(", ")
            found.update(dict.fromkeys(names, entry["text"]))
        elif text:
            found.update({name: f"{found[name]} {text}" for name in names})
    return {name: _plain(text) for name, text in found.items()}


def _plain(text: str) -> str:
    """Return the text of a docstring with code marked as in Markdown, and None as YAML's null."""
    return NONE.sub("`null`", CODE.sub(r"`\1`", text))


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]


class _WithoutTitles(GenerateJsonSchema):
    """Omits the titles of keys, which only repeat their names."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False
