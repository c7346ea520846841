"""Requests for worlds: their seed, and what else is set in them."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import parse_plain_json
from oaisys_core.types import ModuleMetadata
from oaisys_ros_bridge.bridge.metadata import metadata_of_modules

SCHEME = "oaisys:"
NEXT = "next"
KEYS = frozenset({"seed", "reuse_stage", "metadata"})


@dataclass(frozen=True)
class WorldRequest:
    """A world to build.

    Attributes:
        seed: Of the world; None: the next one of the simulator's series.
        reuse_stage: Whether the ground is kept.
        metadata: By module; None: as configured.
    """

    seed: int | None = None
    reuse_stage: bool = False
    metadata: ModuleMetadata | None = None

    @property
    def uri(self) -> str:
        """Its URI as a resource; it does not contain the metadata."""
        return SCHEME + (NEXT if self.seed is None else str(self.seed))


def world_from_uri(uri: str) -> WorldRequest | None:
    """Return the world of a URI ``oaisys:SEED`` or ``oaisys:next``; None for any other."""
    match = re.fullmatch(rf"{SCHEME}({NEXT}|\d{{1,19}})", uri)
    if match is None:
        return None
    return WorldRequest(None if match[1] == NEXT else int(match[1]))


def world_from_json(text: str) -> WorldRequest:
    """Return the world that a JSON object of `KEYS` describes; all keys are optional.

    Raises:
        InvalidInputError: Not such an object.
    """
    try:
        value = parse_plain_json(text)
    except ValueError as error:
        raise InvalidInputError("resource_string", text, f"a JSON object ({error})") from None
    if not isinstance(value, dict) or not value.keys() <= KEYS:
        expected = f"a JSON object with keys out of {', '.join(sorted(KEYS))}"
        raise InvalidInputError("resource_string", text, expected)
    seed, reuse_stage = value.get("seed"), value.get("reuse_stage", False)
    if seed is not None and (type(seed) is not int or not 0 <= seed < 2**63):
        raise InvalidInputError("resource_string.seed", seed, "a whole number, 0 or more, or null")
    if not isinstance(reuse_stage, bool):
        raise InvalidInputError("resource_string.reuse_stage", reuse_stage, "true or false")
    metadata = metadata_of_modules(json.dumps(value["metadata"])) if "metadata" in value else None
    return WorldRequest(seed, reuse_stage, metadata)
