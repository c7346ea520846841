"""Grass that stands on layers of the ground: patches of short blades, and taller tufts.

Blades have the colour of the layer's texture, so that they stand out by their forms alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oaisys_core.color import mean_linear, srgb
from oaisys_core.procedural.scatter.mesh_builder import CUTICLE, MeshBuilder
from oaisys_core.procedural.scatter.plants.growth import UP, StemRule, level_vectors, stems
from oaisys_core.procedural.scatter.plants.organs import (
    Organs,
    add_blades,
    add_leaves,
)
from oaisys_core.scene import MeshPrototype, PbrMaps
from oaisys_core.types import FloatArray

STRAW = np.array((0.42, 0.33, 0.15))
"""Linear reflectance of dry blades."""

FOOT, TIP = 0.8, 1.5
"""Colour of blades at their feet and tips, relative to that of the texture: upright blades get less
light than the ground, and shade each other."""

TRANSLUCENCY = 0.16
"""Of blades: less than that of broad leaves, because bunches of them are thick."""

SAMPLED_PX, LEAST_GREEN, OF_GREEN = 256, 0.05, 0.6
"""Texels of a row of which the colour is taken, the least share of them that is green, and the
share of these in the colour; the rest is that of the whole texture."""

HERB = np.array((1.0, 1.1, 1.0))
"""Colour of leaves of herbs, relative to that of the grass."""

RIM_STUNTING = 0.4
"""Share of their length that blades at the rim of a patch lack."""


class Tuft(NamedTuple):
    """A patch of grass that many instances share; sizes are in metres.

    Attributes:
        per_m2: Instances where the layer covers all of the ground.
        width_m: (least, largest) width of the patch.
        blades: Number of blades.
        length_m, blade_m: (least, largest) lengths and widths of blades.
        bunches: Number of bunches in which they grow; towards the rim they are fewer.
        lean: Standard deviation of the slope by which they lean, along either axis.
        bend: By how much they hang over.
        dry: Share of straw in their colour.
        herbs: Number of rosettes of leaves.
        clumping: How much they stand in clumps: 0 anywhere, 1 only in the best half of places.
        max_slope_deg: Steepest ground on which it stands.
    """

    per_m2: float
    width_m: tuple[float, float]
    blades: int
    length_m: tuple[float, float]
    blade_m: tuple[float, float]
    bunches: int
    lean: float
    bend: float
    dry: float
    herbs: int
    clumping: float
    max_slope_deg: float = 55.0


SWARDS: dict[str, tuple[Tuft, ...]] = {
    "turf": (
        Tuft(7.0, (0.6, 0.85), 520, (0.05, 0.11), (0.0014, 0.003), 150, 0.3, -0.4, 0.08, 6, 0.0),
        Tuft(1.2, (0.2, 0.3), 130, (0.09, 0.18), (0.0016, 0.0035), 9, 0.35, -0.8, 0.15, 0, 0.9),
    ),
    "grass": (
        Tuft(7.0, (0.65, 0.95), 520, (0.09, 0.2), (0.0016, 0.0035), 130, 0.32, -0.6, 0.09, 6, 0.0),
        Tuft(1.2, (0.3, 0.45), 160, (0.18, 0.34), (0.002, 0.005), 9, 0.3, -0.8, 0.15, 0, 0.9),
    ),
}
"""Tufts by name of the texture that they stand on; widths of blades are those of meadow-grass."""


def make_tuft(
    name: str, tuft: Tuft, linear_color: FloatArray, rng: np.random.Generator
) -> MeshPrototype:
    """Return a tuft, scaled to 1 m along its longest axis.

    Args:
        name: Of the mesh.
        tuft: Its form.
        linear_color: (3,) linear colour of its blades, as of `blade_color`.
        rng: Draws it.
    """
    parts = MeshBuilder()
    width_m = float(np.mean(tuft.width_m))
    _add_blades(parts, tuft, width_m, linear_color, rng)
    if tuft.herbs:
        _add_herbs(parts, tuft, width_m, linear_color, rng)
    return parts.mesh_of_size_1(name)


def blade_color(maps: PbrMaps) -> FloatArray:
    """Return the (3,) linear colour of grass: mostly the mean of a texture's green texels."""
    step = max(len(maps.color_srgb) // SAMPLED_PX, 1)
    texels = maps.color_srgb[::step, ::step].reshape(-1, 3)
    green = texels[texels[:, 1] > texels[:, 0]]
    whole = mean_linear(texels)
    if len(green) < LEAST_GREEN * len(texels):
        return whole
    return OF_GREEN * mean_linear(green) + (1 - OF_GREEN) * whole


def _add_blades(
    parts: MeshBuilder,
    tuft: Tuft,
    width_m: float,
    linear_color: FloatArray,
    rng: np.random.Generator,
) -> None:
    count, bunches = tuft.blades, tuft.bunches
    # Half of the width is the bunches'; blades that lean outwards reach farther.
    far = np.sqrt(rng.uniform(size=bunches)) * (0.6 + 0.4 * rng.uniform(size=bunches))
    angle = rng.uniform(0, 2 * np.pi, bunches)
    reach_m = max(width_m / 2 - 0.25 * tuft.length_m[1], 0.25 * width_m)
    centres = reach_m * far[:, None] * np.column_stack((np.cos(angle), np.sin(angle), 0 * angle))
    bunch = rng.integers(bunches, size=count)
    feet = centres[bunch] + 0.014 * level_vectors(rng, count)
    outwards = centres[bunch] / reach_m * 0.3 + tuft.lean * level_vectors(rng, count)
    vigour = (1 - RIM_STUNTING * far**2) * rng.uniform(0.75, 1.0, bunches)
    lengths_m = vigour[bunch] * rng.uniform(*tuft.length_m, count)
    rule = StemRule(1, bend=tuft.bend, wander=0.2, points=4 if tuft.length_m[1] > 0.1 else 3)
    leaves = stems(feet, UP + outwards, lengths_m, np.zeros(count), rule, rng)
    dry = tuft.dry * 2 * rng.uniform(size=bunches)
    dry = np.clip(dry[bunch] * 2 * rng.uniform(size=count), 0, 1)[:, None]
    bright = np.exp(rng.normal(0, 0.2, (count, 1)))
    color = bright * ((1 - dry) * linear_color + dry * STRAW)
    widths_m = rng.uniform(*tuft.blade_m, count)
    add_blades(parts, leaves, widths_m, _seen(FOOT * color), _seen(TIP * color), rng, TRANSLUCENCY)


def _add_herbs(
    parts: MeshBuilder,
    tuft: Tuft,
    width_m: float,
    linear_color: FloatArray,
    rng: np.random.Generator,
) -> None:
    """Add rosettes of broad leaves, as of plantain and dandelion, among the blades."""
    each = 7
    count = tuft.herbs * each
    centres = 0.3 * width_m * np.repeat(level_vectors(rng, tuft.herbs), each, axis=0)
    angle = rng.uniform(0, 2 * np.pi, count)
    ways = np.column_stack((np.cos(angle), np.sin(angle), rng.uniform(0.3, 1.2, count)))
    long_m = rng.uniform(0.2, 0.4, count) * tuft.length_m[1]
    color = np.exp(rng.normal(0, 0.15, (count, 1))) * HERB * linear_color
    organs = Organs(centres, ways, long_m, 0.3 * long_m, _seen(color))
    add_leaves(parts, organs, rng, droop=0.4, face_up=3.0)


def _seen(linear_color: FloatArray) -> FloatArray:
    """Return (N, 3) sRGB colours that are (N, 3) linear ones under the wax of leaves."""
    bare = (linear_color - CUTICLE) / (1 - CUTICLE)
    return np.asarray(srgb(np.clip(np.maximum(bare, 0.35 * linear_color), 0, 1)))
