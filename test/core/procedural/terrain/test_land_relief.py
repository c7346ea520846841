"""The land's patches follow its relief, and its bump map has the relief that the mesh lacks."""

from __future__ import annotations

import numpy as np
import pytest

from oaisys_core.procedural.terrain.masks.relief import Relief
from oaisys_core.procedural.terrain.surroundings.far_ground import FarGroundMesh
from oaisys_core.procedural.terrain.surroundings.kinds import EARTH_RADIUS_M
from oaisys_core.procedural.terrain.surroundings.land import land_around
from oaisys_core.procedural.terrain.surroundings.land_detail import (
    SIZE_PX,
    TEXELS,
    LandReliefPattern,
)
from oaisys_core.procedural.terrain.surroundings.land_masks import PatchyLandMasks, farthest_m
from oaisys_core.procedural.terrain.surroundings.land_relief import land_relief, preferences_of
from oaisys_core.procedural.terrain.surroundings.spectrum import Octave
from oaisys_core.scene import HeightField

HALF_M = 20.0
SHARES = (0.7, 0.3)


@pytest.fixture(scope="module")
def land() -> FarGroundMesh:
    axis_m = np.linspace(-HALF_M, HALF_M, 65)
    height_m = np.sin(axis_m)[:, None] * np.cos(0.7 * axis_m)
    ground = HeightField(height_m.astype(np.float32), (-HALF_M, -HALF_M), axis_m[1] - axis_m[0])
    return land_around(ground, 5, EARTH_RADIUS_M)


def test_a_layer_of_steep_ground_lies_on_the_lands_slopes(land: FarGroundMesh) -> None:
    preferences = np.array([(-0.5, 0.0), (1.2, 0.0)])
    relief = land_relief(land, (0.0, 0.0), HALF_M, farthest_m(HALF_M), preferences)
    extent_m = (-HALF_M, -HALF_M, HALF_M, HALF_M)
    masks = PatchyLandMasks(extent_m, SHARES, 9.0, 0.08, seed=3, relief=relief)
    times = masks.weights.shape[2] // relief.steepness.shape[1]
    on_rock = masks.weights[1][::times, ::times]
    rows = np.linspace(0, len(relief.steepness) - 1, len(on_rock)).astype(int)
    steep = relief.steepness[rows]
    assert np.corrcoef(on_rock.ravel(), steep.ravel())[0, 1] > 0.5
    assert masks.weights.mean(axis=(1, 2)) == pytest.approx(SHARES, abs=0.03)


def test_patches_go_on_around_the_circle(land: FarGroundMesh) -> None:
    preferences = np.array([(-0.5, -1.0), (1.2, 1.0)])
    relief = land_relief(land, (0.0, 0.0), HALF_M, farthest_m(HALF_M), preferences)
    for scores in (relief.prominence, relief.scores(1, (200, 1280))):
        steps = np.abs(np.diff(scores, axis=1)).mean()
        assert np.abs(scores[:, 0] - scores[:, -1]).mean() < 2 * steps


def test_forms_have_the_same_sizes_near_the_stage_and_far_from_it(land: FarGroundMesh) -> None:
    relief = land_relief(land, (0.0, 0.0), HALF_M, farthest_m(HALF_M), np.zeros((2, 2)))
    per_e_fold = relief.prominence.shape[1] / (2 * np.pi)
    borders_per_m = []
    for distance in (1.5, 3.0, 6.0):
        row = round(np.log(distance) * per_e_fold)
        rows = relief.prominence[row - 5 : row + 6] > 0
        borders = (rows[:, 1:] != rows[:, :-1]).sum(axis=1).mean()
        borders_per_m.append(borders / (2 * np.pi * distance * HALF_M))
    assert max(borders_per_m) < 1.5 * min(borders_per_m)


def test_preferences_are_those_that_the_stage_shows() -> None:
    slope = np.tile(np.linspace(0, 1, 64, dtype=np.float32), (64, 1))
    relief = Relief(np.zeros((64, 64), np.float32), slope)
    steep = (slope > 0.7).astype(np.float32)
    found = preferences_of(relief, np.stack((1 - steep, steep)))
    assert found[0, 0] < -0.3
    assert found[1, 0] > 1.0


def test_the_bump_map_repeats_seamlessly_and_has_the_spectrums_heights() -> None:
    octaves = tuple(Octave(0.5 * 2**index, 0.005 * 2**index) for index in range(14))
    detail = LandReliefPattern(octaves, seed=2)
    spectrum = np.abs(np.fft.rfft2(detail.pattern))
    assert detail.pattern.std() == pytest.approx(1)
    assert spectrum[SIZE_PX // TEXELS + 1 : SIZE_PX // 2].max() < 1e-3 * spectrum.max()
    for band in detail.bands:
        shortest_m = band.period_m * TEXELS / SIZE_PX
        # Four octaves, each with 1 % of its wavelength.
        assert band.deviation_m == pytest.approx(0.01 * shortest_m * np.sqrt(85))
