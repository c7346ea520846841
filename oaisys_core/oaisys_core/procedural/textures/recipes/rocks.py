"""Recipes of bare rock: weathered faces, layered pavements, ropy lava."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.textures import cells, fields
from oaisys_core.procedural.textures.recipes.finish import (
    Color,
    Recipe,
    TextureMaps,
    blend,
    darken_hollows,
    dusty,
    finish_maps,
    smoothstep,
    tint,
)


def rock(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Weathered, brown sandstone."""
    return _weather(size_px, rng, (0.55, 0.48, 0.40))


def basalt(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Dark grey rock with the bubbles of its lava, to lie on regolith."""
    plain = _weather(size_px, rng, (0.36, 0.355, 0.348), staining=0.009)
    gassy = np.clip(0.3 + 0.5 * fields.tile_noise(size_px, 4, rng, 1.8), 0.02, 1)
    holes = fields.spread(size_px, 6500, (0.0014, 0.010), 2.4, rng, gassy)
    depth = fields.domes(size_px, *holes) / size_px
    color = plain.color * (1 - 0.35 * smoothstep(0.0, 0.004, depth))[..., None]
    return TextureMaps(color, plain.height - 0.8 * depth, plain.roughness)


def bedrock(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """A pavement of layered rock: slabs between joints, broken steps, sand in the low parts."""
    blocks = cells.joint_blocks(size_px, (3, 1), rng, bend=0.012)
    breaks = cells.voronoi(size_px, 8, rng, warp=0.07, jitter=0.47, smooth=2.6)
    slabs = cells.intersect(blocks, breaks)
    joint = cells.border_distance(blocks) / np.float32(size_px)
    crack = cells.border_distance(slabs) / np.float32(size_px)
    ragged = fields.tile_noise(size_px, 40, rng, 1.3)
    rough = fields.tile_noise(size_px, 12, rng, 1.8)
    grain = fields.grains(size_px, rng, 0.8)
    # Layers weather one by one and end in broken steps.
    mass = fields.tile_noise(size_px, 4, rng, 1.8) + 0.3 * cells.per_cell(slabs, rng)
    layer = 2.6 * mass + 0.10 * ragged
    part = layer - np.floor(layer)
    terraces = np.floor(layer) + smoothstep(0.80, 1.0, part) + 0.12 * part
    height = 0.0026 * terraces + 0.0022 * cells.per_cell(slabs, rng)
    height += 0.02 * cells.facet_heights(slabs, rng)
    height += 0.0006 * rough + 0.00025 * ragged + 0.00010 * grain
    worn = 0.004 * np.exp(-crack / 0.003) + 0.006 * np.exp(-joint / 0.006)
    gap = np.maximum(
        smoothstep(0.0030, 0.0008, joint + 0.0006 * ragged),
        0.7 * smoothstep(0.0018, 0.0004, crack + 0.0005 * ragged),
    )
    height -= worn + 0.010 * gap
    band = np.interp(np.arange(64), np.arange(64), rng.normal(0, 1, 64)).astype(np.float32)
    tone = 1 + 0.05 * band[np.floor(layer).astype(np.int64) % 64] + 0.04 * rough + 0.035 * ragged
    tone += 0.03 * grain + 0.06 * cells.per_cell(slabs, rng) - 0.2 * gap
    color = tint(tone, (0.30, 0.245, 0.185))
    stain = smoothstep(0.4, 1.8, fields.tile_noise(size_px, 5, rng, 1.5))
    color = blend(color, (0.20, 0.135, 0.085), 0.45 * stain)
    sanded = height + 0.0004 * fields.tile_noise(size_px, 20, rng, 1.6)
    level = np.float32(np.quantile(sanded, 0.13))
    sand = smoothstep(0.0010, -0.0006, sanded - level)
    fill = level + 0.0010 * fields.tile_noise(size_px, 8, rng, 2.1) + 0.00008 * grain
    height = height + (np.maximum(height, fill) - height) * sand
    drifted = tint(1 + 0.05 * grain + 0.02 * ragged, (0.325, 0.255, 0.18))
    color = blend(color, drifted, sand)
    return finish_maps(color, height, 0.88 + 0.03 * grain, albedo=0.23, shade=0.7)


def lava(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Ropy lava: lobes whose skin was pushed into folds, creases between them, bubbles."""
    lobes = cells.voronoi(size_px, 4, rng, warp=0.10, jitter=0.42, smooth=2.6)
    edge = cells.border_distance(lobes) / np.float32(size_px)
    x, y = cells.from_centre(lobes)
    flow = rng.normal(0.6, 0.5, int(lobes.max()) + 1)[lobes].astype(np.float32)
    # Folds are arcs around the origin of the lobe, a little upstream.
    away = np.hypot(x + 0.16 * np.cos(flow), y + 0.16 * np.sin(flow))
    away += 0.010 * fields.tile_noise(size_px, 4, rng, 2.2)
    away += 0.0022 * fields.tile_noise(size_px, 14, rng, 1.9)
    pace = rng.uniform(20, 38, int(lobes.max()) + 1)[lobes].astype(np.float32)
    rope = np.sqrt(np.abs(np.sin(np.pi * pace * away)) + 0.02)
    calm = smoothstep(-0.9, 0.9, fields.tile_noise(size_px, 4, rng, 2.0))
    strength = (0.25 + 0.75 * calm) * smoothstep(0.0, 0.02, edge)
    wrinkle = fields.tile_noise(size_px, 30, rng, 1.6)
    grain = fields.grains(size_px, rng, 0.8)
    height = 0.009 * strength * rope + 0.012 * np.sqrt(np.clip(edge / 0.1, 0, 1))
    height += 0.0030 * fields.tile_noise(size_px, 4, rng, 2.1) + 0.00035 * wrinkle
    holes = fields.spread(size_px, 5000, (0.0008, 0.0045), 2.2, rng, np.clip(1.1 - calm, 0.1, 1))
    depth = fields.domes(size_px, *holes) / size_px
    height += 0.00010 * grain - 0.7 * depth
    tone = 1 + 0.12 * (rope - 0.6) * strength + 0.06 * wrinkle + 0.06 * grain
    tone += 0.08 * cells.per_cell(lobes, rng) + 0.06 * fields.tile_noise(size_px, 3, rng)
    color = tint(tone, (0.072, 0.069, 0.068))
    rusty = smoothstep(0.6, 2.0, fields.tile_noise(size_px, 6, rng, 1.5))
    color = blend(color, (0.11, 0.075, 0.052), 0.5 * rusty)
    low = smoothstep(0.0, -0.006, height - fields.blur(height.astype(np.float32), size_px / 60))
    color = blend(color, (0.115, 0.10, 0.085), 0.45 * low)
    return finish_maps(color, height, 0.68 + 0.1 * low + 0.05 * wrinkle, albedo=0.068, shade=0.7)


def _weather(
    size_px: int, rng: np.random.Generator, tone: Color, staining: float = 0.025
) -> TextureMaps:
    """Return bare rock: faint layers, broken steps, pits, cracks, stains."""
    layers = fields.strata(size_px, 22, rng)
    mass = fields.tile_noise(size_px, 4, rng, 1.9)
    rough = fields.tile_noise(size_px, 14, rng, 1.7)
    steps = fields.crests(size_px, 5, rng)
    grain = fields.grains(size_px, rng, 0.8)
    # Cracks exist only where the rock is weak, so that they have ends.
    weak = np.clip(1.5 * fields.tile_noise(size_px, 2, rng, 2.2) - 0.2, 0, 1)
    split = weak * fields.cracks(size_px, 6, rng, width=0.022)
    pits = np.clip(fields.tile_noise(size_px, 45, rng, 1.7) - 1.6, 0, 1.5)
    height = 0.005 * layers + 0.005 * mass + 0.0011 * rough + 0.010 * steps
    height += 0.0002 * grain - 0.006 * split - 0.002 * pits
    color = dusty(size_px, rng, tone, 0.05)
    color *= (1 + 0.05 * layers + 0.055 * rough + 0.16 * (steps - 0.6) - 0.3 * split)[..., None]
    stain = fields.tile_noise(size_px, 3, rng)[..., None]
    color *= 1 + staining * stain * np.array((1.0, 0.4, -0.3), np.float32)
    color *= (1 - 0.18 * np.clip(pits, 0, 1))[..., None]
    return darken_hollows(color, height.astype(np.float32), rng, roughness=0.87)


RECIPES: dict[str, Recipe] = {
    "rock": Recipe(rock, tile_m=2.0, albedo=(0.1, 0.25), exposure=1.0, stands_out=True),
    "basalt": Recipe(basalt, tile_m=2.0, albedo=(0.06, 0.13), exposure=1.0, stands_out=True),
    "bedrock": Recipe(bedrock, tile_m=4.0, albedo=(0.15, 0.3), exposure=1.0, stands_out=True),
    "lava": Recipe(lava, tile_m=3.0, albedo=(0.04, 0.1), exposure=0.6, stands_out=True),
}
