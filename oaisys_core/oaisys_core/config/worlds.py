"""The configuration of one world: all values that worlds draw are drawn by its seeds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import ValidationError

from oaisys_core import randomness
from oaisys_core.config.draws import Location, RangeDraw, name_of, pick_index, put, value_at
from oaisys_core.config.expectations import faults_of
from oaisys_core.config.model import SimulationConfig
from oaisys_core.config.variants import SECTIONS, section_of, set_section
from oaisys_core.errors import InvalidInputError

STREAM = "config"
"""How the names of the random streams of draws begin."""

VARIANT = "variant"
"""Name under which the variant stands among the values that were drawn."""


TRIED_WORLDS = 64
"""Worlds that are drawn to find values that do not fit together."""


@dataclass(frozen=True)
class WorldSeeds:
    """The seeds that a world's values are drawn by.

    Attributes:
        seed: Of the world.
        stage_seed: Of stage and materials; another one on a reused stage.
        asset_seed: Of the assets; another one if they were kept from an earlier world.
    """

    seed: int
    stage_seed: int
    asset_seed: int

    @classmethod
    def of(cls, seed: int) -> WorldSeeds:
        """Return the seeds of a world that reuses nothing."""
        return cls(seed, seed, seed)

    def of_section(self, name: str) -> int:
        """Return the seed that the values of a section are drawn by."""
        if name in ("stage", "materials"):
            return self.stage_seed
        return self.asset_seed if name == "assets" else self.seed


@dataclass(frozen=True)
class WorldConfig:
    """The configuration of one world.

    Attributes:
        config: The configuration, in which nothing is left to draw.
        drawn: What was drawn, as JSON data by its path; ``variant`` is the variant's name.
    """

    config: SimulationConfig
    drawn: Mapping[str, Any] = field(default_factory=dict)


def draw_world(config: SimulationConfig, seeds: WorldSeeds) -> WorldConfig:
    """Return the configuration of a world.

    Each value has a random stream of its own, so that one more does not change the others.

    Raises:
        InvalidInputError: The values do not fit together.
    """
    drawn: dict[str, Any] = {}
    locations: list[Location] = []
    if config.variants:
        config = _choose_variant(config, seeds, drawn)
    while config.draws:
        data = config.model_dump()
        for location, draw in config.draws.items():
            rng = _rng(seeds.of_section(str(location[0])), name_of(location, data))
            put(data, location, draw.pick(rng))
            locations.append(location)
        config = _check(data, "draws")
    data = config.model_dump(mode="json")
    drawn |= {".".join(map(str, location)): value_at(data, location) for location in locations}
    return WorldConfig(config, drawn)


def possible_configs(config: SimulationConfig) -> Iterator[SimulationConfig]:
    """Yield configurations in which together each value occurs that a world may draw.

    In each, one value is another one than in the first; the ends of ranges stand for the range.
    """
    yield config
    for location, draw in config.draws.items():
        for option in draw.options[0 if isinstance(draw, RangeDraw) else 1 :]:
            data = config.with_first_values().model_dump()
            put(data, location, option)
            yield from _nested(_check(data), location)
    for variant in config.variants:
        data = config.with_first_values().model_dump()
        yield from possible_configs(_check(variant.apply_to(data)))


def contradictions(config: SimulationConfig, worlds: int = TRIED_WORLDS) -> Iterator[str]:
    """Yield what is wrong with values that some worlds draw together.

    Args:
        config: The configuration.
        worlds: Number of worlds that are drawn to find out.
    """
    if not (config.draws or config.variants):
        return
    told: set[str] = set()
    for number in range(1, worlds + 1):
        seed = randomness.batch_seed(config.seed, number)
        try:
            draw_world(config, WorldSeeds.of(seed))
        except InvalidInputError as error:
            if error.expected not in told:
                yield f"{error} (world {number - 1} draws values that do not fit together)"
            told.add(error.expected)


def _nested(config: SimulationConfig, location: Location) -> Iterator[SimulationConfig]:
    """Yield a configuration, and those of the draws inside of a value that was chosen."""
    yield config
    for inner, draw in config.draws.items():
        if inner[: len(location)] == location:
            for option in draw.options[1:]:
                data = config.with_first_values().model_dump()
                put(data, inner, option)
                yield from _nested(_check(data), inner)


def _choose_variant(
    config: SimulationConfig, seeds: WorldSeeds, drawn: dict[str, Any]
) -> SimulationConfig:
    data = config.model_dump()
    del data["variants"]
    weights = [variant.weight for variant in config.variants]
    for name in SECTIONS:
        rng = _rng(seeds.of_section(name), "variants")
        variant = config.variants[pick_index(len(weights), weights, rng)]
        set_section(data, name, section_of(variant.apply_to(data), name))
    drawn[VARIANT] = variant.name  # the last section is drawn by the world's own seed
    return _check(data)


def _rng(seed: int, name: str) -> Any:
    return randomness.stream(seed, f"{STREAM}/{name}")


def _check(data: dict[str, Any], whole: str = "configuration") -> SimulationConfig:
    """Return the checked configuration; errors about all of it name it as ``whole``."""
    try:
        return SimulationConfig.model_validate(data)
    except ValidationError as error:
        fault = faults_of(error, data, SimulationConfig)[0]
        expected = fault.expected + fault.hint
        raise InvalidInputError(fault.path or whole, fault.received, expected) from error
