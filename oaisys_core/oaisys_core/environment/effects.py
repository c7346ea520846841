"""Environment effects of other packages, found by their entry points."""

from __future__ import annotations

from abc import abstractmethod
from importlib.metadata import entry_points

import numpy as np
from pydantic import ValidationError

from oaisys_core.config.environment import EffectConfig
from oaisys_core.config.section import Section
from oaisys_core.errors import InvalidInputError
from oaisys_core.extensions import load
from oaisys_core.sky import Sky

GROUP = "oaisys.environment_effects"


class EnvironmentEffect(Section):
    """Changes the sky of a batch; a package registers its subclass as an entry point.

    Its fields are the options that the configuration may give beside the effect's name. It must
    not keep anything from one call to the next: a restored world starts in the middle.
    """

    @abstractmethod
    def apply(self, sky: Sky, rng: np.random.Generator) -> Sky:
        """Return the changed sky; called whenever the environment is set or drawn anew."""


def load_effects(configs: tuple[EffectConfig, ...]) -> tuple[EnvironmentEffect, ...]:
    """Return the effects that a configuration names, with their options checked.

    Raises:
        InvalidInputError: There is no such effect, or an option does not fit.
    """
    return tuple(_load(index, config) for index, config in enumerate(configs))


def _load(index: int, config: EffectConfig) -> EnvironmentEffect:
    path = f"environment.effects.{index}"
    found = {point.name: point for point in entry_points(group=GROUP)}
    if config.effect not in found:
        names = ", ".join(sorted(found)) or "none is installed"
        raise InvalidInputError(f"{path}.effect", config.effect, f"an installed effect ({names})")
    kind = load(GROUP, config.effect)
    if not (isinstance(kind, type) and issubclass(kind, EnvironmentEffect)):
        raise InvalidInputError(f"{path}.effect", kind, "a subclass of EnvironmentEffect")
    try:
        return kind(**config.options)
    except ValidationError as error:
        detail = error.errors()[0]
        where = ".".join((path, *(str(part) for part in detail["loc"])))
        raise InvalidInputError(where, detail["input"], detail["msg"]) from error
