"""What a caller changes with a step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

OWN_PARTS = frozenset({"sensor", "environment", "asset", "render"})
"""Parts of `ModuleMetadata` that are fields of their own; all others are in ``custom``."""


@dataclass(frozen=True)
class ModuleMetadata:
    """What a caller changes with a step, by module; an absent part changes nothing.

    Each part is a mapping of the module's own keys; a module refuses keys that it does not know.
    The pose of the rig is ``sensor["pose"]`` (`Pose`).
    """

    sensor: Mapping[str, Any] | None = None
    environment: Mapping[str, Any] | None = None
    asset: Mapping[str, Any] | None = None
    render: Mapping[str, Any] | None = None
    custom: Mapping[str, Any] = field(default_factory=dict)

    def part(self, name: str) -> Mapping[str, Any] | None:
        """Return a part by its name, a field or a key of ``custom``; None if it is absent."""
        part: Mapping[str, Any] | None
        part = getattr(self, name) if name in OWN_PARTS else self.custom.get(name)
        return part

    def with_update(self, later: ModuleMetadata) -> ModuleMetadata:
        """Return this metadata with ``later`` applied.

        Nested mappings are merged key by key; any other value replaces the earlier one.
        """
        return ModuleMetadata(
            sensor=merge(self.sensor, later.sensor),
            environment=merge(self.environment, later.environment),
            asset=merge(self.asset, later.asset),
            render=merge(self.render, later.render),
            custom=merge(self.custom, later.custom),
        )


def merge(earlier: Mapping[str, Any] | None, later: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return two mappings merged at any depth; values of ``later`` replace earlier ones."""
    result = dict(earlier or {})
    for key, value in (later or {}).items():
        both = isinstance(value, Mapping) and isinstance(result.get(key), Mapping)
        result[key] = merge(result[key], value) if both else value
    return result
