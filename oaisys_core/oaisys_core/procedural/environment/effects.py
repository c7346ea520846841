"""Environment effects that other packages register as entry points."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from pydantic import ValidationError

from oaisys_core.config.expectations import refusal
from oaisys_core.config.section import Section
from oaisys_core.config.sections.environment import EffectConfig
from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.extensions import EFFECTS as GROUP
from oaisys_core.extensions import load, names
from oaisys_core.scene.sky import Sky


class EnvironmentEffect(Section):
    """Base of environment effects; a package registers its subclass as an entry point.

    Its fields are the options that the configuration may set beside the effect's name. It must not
    keep state between calls, because a restored world may start at any sample.
    """

    @abstractmethod
    def apply(self, sky: Sky, rng: np.random.Generator) -> Sky:
        """Return the changed sky; called whenever the environment is set or redrawn."""


def load_effects(configs: tuple[EffectConfig, ...]) -> tuple[EnvironmentEffect, ...]:
    """Return the effects that a configuration lists, with checked options.

    Raises:
        InvalidInputError: There is no such effect, or an option is invalid.
    """
    return tuple(_load(index, config) for index, config in enumerate(configs))


def _load(index: int, config: EffectConfig) -> EnvironmentEffect:
    path = f"environment.effects.{index}"
    if config.effect not in names(GROUP):
        known = one_of(names(GROUP), config.effect)
        raise InvalidInputError(f"{path}.effect", config.effect, f"an installed effect: {known}")
    kind = load(GROUP, config.effect)
    if not (isinstance(kind, type) and issubclass(kind, EnvironmentEffect)):
        raise InvalidInputError(f"{path}.effect", kind, "a subclass of EnvironmentEffect")
    try:
        return kind(**config.options)
    except ValidationError as error:
        raise refusal(error, config.options, kind, path) from error
