"""Where the layers of the ground's material lie, on the stage and on the land around it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.config.sections.layer_conditions import ConditionConfig
from oaisys_core.config.sections.layers import LayerConfig
from oaisys_core.config.sections.materials import MaterialsConfig
from oaisys_core.procedural.terrain.masks.cover import habitat
from oaisys_core.procedural.terrain.masks.patches import (
    LayerNoise,
    blend_masks,
    border_softness,
    layer_masks,
)
from oaisys_core.procedural.terrain.masks.relief import RELIEF_PX, exposure, relief_of
from oaisys_core.procedural.terrain.surroundings.land_masks import PatchyLandMasks, farthest_m
from oaisys_core.procedural.terrain.surroundings.land_relief import ReliefAround
from oaisys_core.procedural.terrain.water.moisture import moisture
from oaisys_core.scene import Ground
from oaisys_core.scene.surroundings import LandMasks
from oaisys_core.scene.terrain_material import TerrainMaterial
from oaisys_core.world.module import World, require
from oaisys_core.world.modules.layer_gates import gate_of_level, layer_gates
from oaisys_core.world.modules.layers import exposure_of

NO_SHARE = 1.0
"""Share of a layer without one, if another layer has a share."""


RELIEF_STRENGTH = 2.0
"""Change of a patch's score, in standard deviations of patches, where the ground is one standard
deviation more exposed and the layer lies on exposed ground only."""

BARE_ROCK = 0.9
"""Exposure from which on a layer is bare rock."""

WALL_DEG = (38.0, 52.0)
"""Slopes from which on gravel, soil and plants lie less and less where there is bare rock, and not
at all."""

OFF_WALLS = 30.0
"""By how much the score of a layer is less there, for a difference of exposure of 1."""

NOISE_SOFTNESS = 0.07
"""Width of the borders on the land around a stage whose layers lie by the method ``noise``."""


def layer_weights(
    config: MaterialsConfig,
    layers: Sequence[LayerConfig],
    ground: Ground,
    rng: np.random.Generator,
    green: Sequence[bool],
    snowy: Sequence[bool],
    water_m: float | None = None,
) -> NDArray[np.float32]:
    """Return (L, M, M) weights of the layers on the stage; see `weights_of` for plants and snow.

    Below a level of water, ``water_m``, lie other layers than of plants, if there are any.
    """
    mask = config.mask
    size_m = (
        ground.extent_m[2] - ground.extent_m[0],
        ground.extent_m[3] - ground.extent_m[1],
    )
    shares = None
    if any(layer.share is not None for layer in layers):
        shares = [layer.share or NO_SHARE for layer in layers]
    conditions = [layer.when for layer in layers]
    gates = layer_gates(conditions, ground, mask.size_px, green=green, water_m=water_m)
    if mask.method == "patches":
        return blend_masks(
            len(layers),
            size_m[0],
            mask.size_px,
            rng,
            scale_m=mask.scale_m,
            sharpness=mask.sharpness,
            shares=shares,
            gates=gates,
            preferences=_preferences(config, layers, ground, green),
            green=green,
            snowy=snowy,
        )
    rngs = [randomness.child(rng, f"noise/{index}") for index in range(len(layers))]
    noise = mask.noise
    ranges = (noise.scale, noise.detail, noise.roughness, noise.distortion)
    noises = [LayerNoise(*(float(each.uniform(*bounds)) for bounds in ranges)) for each in rngs]
    return layer_masks(
        noises, size_m, mask.size_px, rngs, noise.borders, shares=shares, gates=gates
    )


def _preferences(
    config: MaterialsConfig, layers: Sequence[LayerConfig], ground: Ground, green: Sequence[bool]
) -> NDArray[np.float32] | None:
    """Return (L, M, M) by how much the ground's forms favour each layer; None if they do not."""
    import cv2

    mask = config.mask
    exposures = np.array([exposure_of(layer) for layer in layers], np.float32)
    if not mask.relief or not (np.ptp(exposures) or any(green)):
        return None
    texel_m = (ground.extent_m[2] - ground.extent_m[0]) / RELIEF_PX
    relief, size = relief_of(ground, RELIEF_PX), (mask.size_px, mask.size_px)
    scores = RELIEF_STRENGTH * exposures[:, None, None] * exposure(relief, texel_m, mask.scale_m)
    barest = exposures.max()
    if barest >= BARE_ROCK:
        least_rad, most_rad = np.radians(WALL_DEG, dtype=np.float32)
        wall = np.clip((relief.slope_rad - least_rad) / (most_rad - least_rad), 0, 1)
        scores -= OFF_WALLS * (barest - exposures)[:, None, None] * wall
    if any(green):
        wet = cv2.resize(moisture(ground), (RELIEF_PX, RELIEF_PX), interpolation=cv2.INTER_CUBIC)
        scores[np.array(green)] += habitat(relief, np.asarray(wet, np.float32))
    wide = [cv2.resize(each, size, interpolation=cv2.INTER_CUBIC) for each in scores]
    return np.asarray(np.float32(mask.relief) * np.array(wide), np.float32)


def land_weights(
    config: MaterialsConfig,
    material: TerrainMaterial,
    conditions: Sequence[ConditionConfig | None],
    world: World,
    rng: np.random.Generator,
    green: Sequence[bool],
    snowy: Sequence[bool],
) -> LandMasks | None:
    """Return the masks of the ground around the stage; None if the stage's go on mirrored.

    On land, layers have the same shares as on the stage. A plain around a stage whose layers have
    conditions has those of them that lie on level ground.
    """
    x0, y0, x1, y1 = material.extent_m
    shares = material.masks.mean(axis=(1, 2), dtype=np.float64)
    relief = None
    if world.is_in_land:
        ground = require(world.ground)
        world.far_ground = world.surroundings.around(ground, world.far_ground)
        reach_m = farthest_m(min(x1 - x0, y1 - y0) / 2)
        relief = ReliefAround(world.far_ground, ground, material.masks, reach_m)
    else:
        shares *= [1.0 if when is None else gate_of_level(when) for when in conditions]
        if not any(conditions) or not shares.any():
            return None
    mask = config.mask
    patch_m, softness = mask.scale_m, border_softness(mask.sharpness)
    is_green, is_snowy, sharpness = tuple(green), tuple(snowy), mask.sharpness
    if mask.method == "noise":
        is_green, is_snowy, sharpness = (), (), 1.0
        patch_m = max(x1 - x0, y1 - y0) / float(np.mean(mask.noise.scale))
        softness = NOISE_SOFTNESS
    return PatchyLandMasks(
        extent_m=material.extent_m,
        shares=tuple(shares.tolist()),
        patch_m=patch_m,
        softness=softness,
        seed=int(randomness.child(rng, "land").integers(2**63)),
        relief=relief,
        is_green=is_green,
        sharpness=sharpness,
        is_snowy=is_snowy,
    )
