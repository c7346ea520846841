"""Masks: sums, shares, conditions in closed form, and the order of layers laid over one another."""

import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.config.sections.layer_conditions import ConditionConfig
from oaisys_core.procedural.terrain.masks.patches import (
    LayerNoise,
    blend_masks,
    gate,
    layer_masks,
)
from oaisys_core.procedural.terrain.masks.relief import exposure, has_steep_parts, relief_of
from oaisys_core.scene import HeightField
from oaisys_core.world.modules.layer_gates import condition_gate

SIZE = 256
NOISE = LayerNoise(scale=6.0, detail=1.5, roughness=0.4, distortion=0.3)


def shares_won(masks: NDArray[np.float32]) -> NDArray[np.float64]:
    return np.bincount(masks.argmax(axis=0).ravel(), minlength=len(masks)) / masks[0].size


def patches(count: int, **more: object) -> NDArray[np.float32]:
    rng = np.random.default_rng(3)
    return blend_masks(count, 60.0, SIZE, rng, 5.0, 0.75, **more)  # type: ignore[arg-type]


def layered(count: int, **more: object) -> NDArray[np.float32]:
    parent = np.random.default_rng(3)
    rngs = [randomness.child(parent, str(index)) for index in range(count)]
    borders = (0.48, 0.52)
    return layer_masks([NOISE] * count, (60.0, 60.0), SIZE, rngs, borders, **more)  # type: ignore[arg-type]


def field(elevation_m: NDArray[np.float64], spacing_m: float) -> HeightField:
    half_m = spacing_m * (len(elevation_m) - 1) / 2
    return HeightField(elevation_m.astype(np.float32), (-half_m, -half_m), spacing_m)


@pytest.mark.parametrize("make", [patches, layered])
def test_weights_sum_to_one_whatever_the_conditions(make: object) -> None:
    gates = np.random.default_rng(0).random((3, SIZE, SIZE)).astype(np.float32)
    gates[:, :40] = 0
    for more in (
        {},
        {"shares": (3, 1, 2)},
        {"gates": gates},
        {"shares": (1, 2, 3), "gates": gates},
    ):
        masks = make(3, **more)  # type: ignore[operator]
        assert masks.dtype == np.float32
        assert np.allclose(masks.sum(axis=0), 1, atol=1e-5)
        assert masks.min() >= 0


@pytest.mark.parametrize("make", [patches, layered])
@pytest.mark.parametrize("shares", [(1, 1), (0.8, 0.2), (6, 3, 1), (1, 2, 3, 4)])
def test_layers_win_their_shares(make: object, shares: tuple[float, ...]) -> None:
    masks = make(len(shares), shares=shares)  # type: ignore[operator]
    assert np.allclose(shares_won(masks), np.array(shares) / sum(shares), atol=0.02)


@pytest.mark.parametrize("make", [patches, layered])
def test_a_layer_lies_only_where_it_may(make: object) -> None:
    gates = np.ones((2, SIZE, SIZE), np.float32)
    gates[1, :, : SIZE // 2] = 0
    masks = make(2, gates=gates)  # type: ignore[operator]
    assert (masks[1, :, : SIZE // 2] == 0).all()
    assert masks[1, :, SIZE // 2 :].max() > 0.99
    gates[:] = 0
    assert (make(2, gates=gates)[0] == 1).all()  # type: ignore[operator]


def test_a_layer_more_does_not_move_the_others() -> None:
    two, three = layered(2), layered(3)
    below = three[:2] / np.maximum(1 - three[2], 1e-9)
    clear = three[2] < 0.5
    assert np.allclose(below[:, clear], two[:, clear], atol=1e-4)


def test_a_gate_ramps_around_its_bounds() -> None:
    values = np.array([0.0, 8.0, 10.0, 12.0, 15.0, 20.0, 21.0, 30.0])
    expected = [0, 0, 0.5, 1, 1, 0.5, 0.25, 0]
    assert np.allclose(gate(values, (10, 20), 4), expected)
    assert np.allclose(gate(values, (10, 20), 0), [0, 0, 0.5, 1, 1, 0.5, 0, 0])


@pytest.mark.parametrize("slope_deg", [0.0, 17.0, 48.0])
def test_the_slope_of_a_plane(slope_deg: float) -> None:
    x = np.linspace(-20, 20, 201)
    tilted = field(np.broadcast_to(np.tan(np.radians(slope_deg)) * x, (201, 201)), 0.2)
    relief = relief_of(tilted, 128)
    inner = np.s_[8:-8, 8:-8]
    assert np.allclose(np.degrees(relief.slope_rad[inner]), slope_deg, atol=0.02)
    assert relief.height_m[64, 0] == pytest.approx(
        np.tan(np.radians(slope_deg)) * (-20 + 40 / 256), abs=1e-4
    )


def test_a_condition_on_a_cone_is_a_ring() -> None:
    # Height 12 - r tan(40 deg) within r < 10, level beyond: known slope and height everywhere.
    axis = np.linspace(-20, 20, 401)
    x, y = np.meshgrid(axis, axis)
    tangent = np.tan(np.radians(40))
    cone = field(tangent * np.maximum(10 - np.hypot(x, y), 0), 0.1)
    relief = relief_of(cone, 400)
    centres = (np.arange(400) + 0.5) / 10 - 20
    radius = np.hypot(*np.meshgrid(centres, centres))
    clear = (abs(radius - 10) > 1) & (radius > 1)
    steep = condition_gate(ConditionConfig(slope_deg=(30, 90), soft_deg=4), relief)
    assert (steep[clear] == (radius < 10)[clear]).all()
    level = condition_gate(ConditionConfig(slope_deg=(0, 30)), relief)
    assert (level[clear] == (radius > 10)[clear]).all()
    high = condition_gate(ConditionConfig(height_m=(4 * tangent, 100), soft_m=0), relief)
    clear &= abs(radius - 6) > 0.2
    assert (high[clear] == (radius < 6)[clear]).all()
    share = condition_gate(ConditionConfig(height_share=(0.4, 1), soft_m=0), relief)
    assert (share[clear] == (radius < 6)[clear]).all()
    assert not has_steep_parts(cone)
    assert has_steep_parts(field(1.6 * cone.elevation_m.astype(np.float64), 0.1))


def test_shares_of_the_height_gate_level_ground_evenly() -> None:
    relief = relief_of(field(np.zeros((64, 64)), 0.5), 64)
    for share in ((0.0, 1.0), (0.2, 1.0), (0.0, 0.4), (0.2, 0.4)):
        gates = condition_gate(ConditionConfig(height_share=share), relief)
        assert 0 < gates.min() == gates.max() <= 1, share


def test_ridges_are_exposed_and_hollows_are_not() -> None:
    x = np.mgrid[:SIZE, :SIZE][1] * 0.25
    waves = relief_of(field(np.cos(2 * np.pi * x / 16), 0.25), SIZE)
    exposed = exposure(waves, 0.25, 4.0)
    crest, trough = waves.height_m > 0.9, waves.height_m < -0.9
    assert exposed[crest].min() > 0.3
    assert exposed[trough].max() < -0.3
    assert abs(exposed.mean()) < 0.1
    assert exposed.std() <= 1 + 1e-5


def test_scarps_are_exposed_and_the_ground_at_their_foot_is_not() -> None:
    x = np.mgrid[:SIZE, :SIZE][1] * 0.25
    step = 4 / (1 + np.exp(-(x - 32) / 0.7))
    exposed = exposure(relief_of(field(step, 0.25), SIZE), 0.25, 4.0).mean(axis=0)
    assert exposed[128:136].min() > 0.5, "upper half of the scarp and its brink, at 32 to 34 m"
    assert exposed[108:116].max() < 0, "foot, at 27 to 29 m"


@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_a_plane_is_nowhere_exposed(slope: float) -> None:
    x = np.mgrid[:SIZE, :SIZE][1] * 0.25
    exposed = exposure(relief_of(field(slope * x, 0.25), SIZE), 0.25, 4.0)
    assert np.abs(exposed[64:192, 64:192]).max() < 0.05


def test_preferences_move_patches_and_keep_shares() -> None:
    side = np.where(np.arange(SIZE) < SIZE // 2, 1.5, -1.5).astype(np.float32)
    preferences = np.stack([np.broadcast_to(side, (SIZE, SIZE)), np.zeros((SIZE, SIZE))])
    masks = patches(2, preferences=preferences.astype(np.float32))
    assert masks[0, :, : SIZE // 2].mean() > masks[0, :, SIZE // 2 :].mean() + 0.4
    assert shares_won(masks)[0] == pytest.approx(0.5, abs=0.02)
