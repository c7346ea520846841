"""All recipes of the built-in texture sets: what the ground is made of, seen from above."""

from __future__ import annotations

from oaisys_core.textures.recipes import earth, frozen, loose, organic, rocks
from oaisys_core.textures.recipes.finish import Recipe

RECIPES: dict[str, Recipe] = {
    **loose.RECIPES,
    **rocks.RECIPES,
    **earth.RECIPES,
    **organic.RECIPES,
    **frozen.RECIPES,
}
