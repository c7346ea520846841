"""A module that plants one landing target at a random place of the ground."""

from __future__ import annotations

import numpy as np

from oaisys_core.config.section import Positive, Section
from oaisys_core.geometry import transform
from oaisys_core.scene import Primitive
from oaisys_core.world.extension_modules import ExtensionModule
from oaisys_core.world.module import Metadata, World, require


class FlagOptions(Section):
    """What ``extensions: {flag: {...}}`` may say."""

    size_m: Positive = 0.5


class FlagModule(ExtensionModule):
    """Adds a box to the world; all else is drawn as it is without it."""

    name = "flag"
    options_type = FlagOptions

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Plant the box of a new world."""
        ground, size_m = require(world.ground), float(self.options.size_m)
        x0, y0, x1, y1 = ground.extent_m
        x, y = rng.uniform((x0, y0), (x1, y1)) * 0.5
        pose = transform(np.eye(3), (x, y, float(ground.height_at([(x, y)])[0])))
        box = Primitive("box", (size_m,) * 3, pose, 4_000_000, (999,), (0.9, 0.1, 0.1))
        world.primitives = (*world.primitives, box)
        world.semantic_labels[999] = "flag"
