"""The JSON Schema of the configuration, for editors and other programs."""

from __future__ import annotations

import json
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema

from oaisys_core.config.descriptions import all_models, descriptions, summary
from oaisys_core.config.model import SimulationConfig

DIALECT = "https://json-schema.org/draft/2020-12/schema"


class _WithoutTitles(GenerateJsonSchema):
    """Omits the titles of keys, which only repeat their names."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def config_schema() -> dict[str, Any]:
    """Return the JSON Schema of the configuration, with a description of each key."""
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
