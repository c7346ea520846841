"""Lamps of a simulation: where they are, what switches them, what is refused, what is restored."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from repository import REPOSITORY

from oaisys_core.color import linear
from oaisys_core.config import adjust, config_from_mapping, load_config
from oaisys_core.config.sections.lamps import MAX_LAMPS
from oaisys_core.errors import CancelledError, ConfigError, InvalidInputError
from oaisys_core.geometry import pose_looking_at, pose_looking_down, pose_to_matrix
from oaisys_core.scene.lamps import Lamp
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, Progress, Sample

HEADLIGHT: dict[str, Any] = {
    "kind": "spot",
    "frame": "base_link",
    "position_m": [0.2, 0.0, 0.1],
    "cone_deg": 70.0,
    "strength_w": 3000.0,
}
MAST = {"position_m": [2.0, 1.0, 3.0], "on_ground": True, "strength_w": 300.0}
WORLD: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"preset": "mounds", "extent_m": 24, "resolution_px": 65, "surroundings": "plain"},
    "materials": {"texture_size_px": 16, "mask": {"size_px": 16, "relief": 0}},
    "assets": {"rocks": [{"count": [5, 5], "variants": 1}]},
    "sensors": {"cameras": [{"width_px": 32, "height_px": 24, "fx_px": 27.0, "fy_px": 27.0}]},
    "render": {"exposure_ev": 0.0},
}
NIGHT: dict[str, Any] = {"sky": {"model": "none"}, "sun_elevation_deg": -10.0}
POSES = [pose_looking_down(1, 1, 6), pose_looking_at((-6, -5, 4), (2, 3, 0))]


def simulation(lamps: dict[str, Any], environment: Any = NIGHT, **sections: Any) -> Simulation:
    config = {**WORLD, "environment": {**environment, "lamps": lamps}, **sections}
    made = Simulation(config_from_mapping(config), pose_cache_bytes=1 << 22)
    made.step_batch(seed=3)
    return made


def switched(pose: int = 0, **lamps: Any) -> ModuleMetadata:
    return ModuleMetadata(sensor={"pose": POSES[pose]}, environment={"lamps": lamps})


def at(pose: int) -> ModuleMetadata:
    return ModuleMetadata(sensor={"pose": POSES[pose]})


def rgb(sample: Sample) -> NDArray[Any]:
    return sample.frame("camera", "rgb").data


def images(sample: Sample) -> list[bytes]:
    return [frame.data.tobytes() for frame in sample.frames]


def in_map(sample: Sample) -> NDArray[Any]:
    """Where the headlight is."""
    return (pose_to_matrix(sample.rig_pose) @ (*HEADLIGHT["position_m"], 1.0))[:3]


def lamp(sim: Simulation, name: str) -> Lamp:
    return next(lamp for lamp in sim.scene.lamps if lamp.name == name)


class TestPlaces:
    """Where lamps are, and where they shine."""

    def test_a_lamp_on_the_ground_has_its_height_above_it(self) -> None:
        sim = simulation({"mast": MAST})
        ground_m = sim.query_height([(2.0, 1.0, 0.0)]).ground_height_m[0]
        assert abs(ground_m) > 0.01
        np.testing.assert_allclose(lamp(sim, "mast").position_m, (2.0, 1.0, 3.0 + ground_m))

    def test_a_lamp_on_the_rig_moves_and_turns_with_it(self) -> None:
        sim = simulation({"left": HEADLIGHT})
        for index, ahead in ((0, (0, 0, -1)), (1, np.array((8, 8, -4)) / 12)):
            sample = sim.step_sample(at(index))
            seen = lamp(sim, "left")
            assert seen.frame == "map"
            np.testing.assert_allclose(seen.forward, ahead, atol=1e-9)
            np.testing.assert_allclose(seen.position_m, in_map(sample), atol=1e-9)

    def test_a_rig_that_moves_by_itself_takes_its_lamps_along(self) -> None:
        motion = {"kind": "hover", "height_above_ground_m": 2.0}
        sim = simulation({"left": HEADLIGHT}, sensors={**WORLD["sensors"], "motion": motion})
        for _ in range(3):
            sample = sim.step_sample()
            np.testing.assert_allclose(lamp(sim, "left").position_m, in_map(sample), atol=1e-9)

    @pytest.mark.parametrize(
        ("frame", "direction", "forward", "right"),
        [
            ("map", None, (0, 0, -1), (1, 0, 0)),
            ("map", [0, 3, 0], (0, 1, 0), (1, 0, 0)),
            ("map", [2, 0, -2], (0.5**0.5, 0, -(0.5**0.5)), (0, -1, 0)),
        ],
    )
    def test_the_width_of_an_area_lamp_is_horizontal(
        self, frame: str, direction: Any, forward: Any, right: Any
    ) -> None:
        sim = simulation(
            {"panel": {**MAST, "kind": "area", "frame": frame, "direction": direction}}
        )
        seen = lamp(sim, "panel")
        np.testing.assert_allclose(seen.forward, forward, atol=1e-12)
        np.testing.assert_allclose(seen.right, right, atol=1e-12)
        np.testing.assert_allclose(np.cross(seen.right, seen.up), -np.array(forward), atol=1e-12)


class TestSwitching:
    """What metadata change, and for how long."""

    def test_a_switch_lasts_until_the_next_batch(self) -> None:
        sim = simulation({"left": HEADLIGHT})
        lit = rgb(sim.step_sample(at(0)))
        dark = rgb(sim.step_sample(switched(left={"enabled": False})))
        still_dark = rgb(sim.step_sample(at(0)))
        assert lit.max() > 100
        assert not dark.any()
        assert not still_dark.any()
        again = rgb(sim.step_sample(switched(left={"enabled": True})))
        assert np.array_equal(again, lit)
        sim.step_sample(switched(left={"enabled": False}))
        sim.step_batch(seed=3)
        assert np.array_equal(rgb(sim.step_sample(at(0))), lit)

    def test_a_new_lamp_is_a_lamp_until_the_next_batch(self) -> None:
        sim = simulation({})
        assert not rgb(sim.step_sample(at(0))).any()
        assert rgb(sim.step_sample(switched(mast=MAST))).any()
        dimmer = sim.step_sample(switched(mast={"strength_w": 30.0}))
        assert lamp(sim, "mast").strength_w == 30.0
        assert dimmer.provenance.metadata_json.count('"mast"') == 1
        sim.step_batch(seed=3)
        assert not rgb(sim.step_sample(at(0))).any()

    def test_the_order_of_switching_does_not_matter(self) -> None:
        colors = {"a": [1.0, 0.2, 0.2], "b": [0.2, 1.0, 0.2]}
        lamps = {name: {**MAST, "color_srgb": color} for name, color in colors.items()}
        one, other = simulation({}), simulation({})
        one.step_sample(switched(a=lamps["a"]))
        first = one.step_sample(switched(b=lamps["b"]))
        other.step_sample(switched(b=lamps["b"]))
        second = other.step_sample(switched(a=lamps["a"]))
        assert one.scene.lamps == other.scene.lamps
        assert images(first) == images(second)

    def test_views_are_kept_for_the_light_they_were_rendered_in(self) -> None:
        sim = simulation({"left": HEADLIGHT})
        lit = sim.step_sample(at(0))
        for change in ({"strength_w": 1.0}, {"cone_deg": 40.0}, {"position_m": [0.0, 0.0, 0.1]}):
            assert not sim.step_sample(switched(left=change)).from_cache
        again = sim.step_sample(switched(left=HEADLIGHT))
        assert again.from_cache
        assert images(again) == images(lit)

    def test_a_sample_that_is_stopped_leaves_the_lamps_as_they_were(self) -> None:
        sim = simulation({"left": HEADLIGHT})
        before = sim.step_sample(at(0))
        state, lamps = sim.state(), sim.scene.lamps

        def stop(progress: Progress) -> None:
            raise CancelledError("stopped")

        with pytest.raises(CancelledError):
            sim.step_sample(switched(1, left={"enabled": False}, mast=MAST), progress=stop)
        assert sim.state() == state
        assert sim.scene.lamps == lamps
        sim.step_sample(switched(1, left={"enabled": False}))
        sim.withdraw_sample()
        assert sim.scene.lamps == lamps
        assert images(sim.step_sample(at(0))) == images(before)

    def test_drawn_strengths_stay_in_their_range_and_change_with_redraws(self) -> None:
        night = {**NIGHT, "redraw": "sample"}
        sim = simulation({"mast": {**MAST, "strength_w": [10.0, 20.0]}}, night)
        seen = []
        for _ in range(4):
            sim.step_sample(at(0))
            seen.append(lamp(sim, "mast").strength_w)
        assert len(set(seen)) == 4
        assert all(10 <= strength <= 20 for strength in seen)


class TestRepeating:
    """A sample's record, or a simulation's state, is enough to get the same light."""

    def lit(self) -> tuple[Simulation, Sample]:
        sim = simulation({"left": HEADLIGHT, "mast": {**MAST, "strength_w": [10.0, 900.0]}})
        sim.step_sample(switched(extra={**MAST, "color_srgb": [1, 0, 0]}, left={"cone_deg": 30}))
        return sim, sim.step_sample(switched(1, mast={"enabled": False}))

    def test_a_restored_simulation_has_the_same_lamps(self) -> None:
        first, _ = self.lit()
        second = simulation({"left": HEADLIGHT, "mast": {**MAST, "strength_w": [10.0, 900.0]}})
        second.restore(json.loads(json.dumps(first.state())))
        assert second.scene.lamps == first.scene.lamps
        assert [lamp.name for lamp in second.scene.lamps] == ["extra", "left"]
        back = switched(1, mast={"enabled": True})
        assert images(first.step_sample(back)) == images(second.step_sample(back))

    def test_a_recorded_sample_is_rendered_again_in_its_light(self) -> None:
        sim, sample = self.lit()
        sim.step_batch(seed=77)
        assert images(sim.repeat(sample.outline)) == images(sample)


class TestGeometry:
    """Lamps change colour only."""

    def test_depth_and_labels_do_not_know_lamps(self) -> None:
        dark, lit = simulation({}), simulation({"mast": {**MAST, "position_m": [1, 1, 1]}})
        one, other = dark.step_sample(at(0)), lit.step_sample(at(0))
        assert images(one)[1:] == images(other)[1:]
        assert images(one)[0] != images(other)[0]

    def test_a_lamp_that_is_off_is_no_lamp(self) -> None:
        none = simulation({}).step_sample(at(0))
        off = {"left": {**HEADLIGHT, "enabled": False}, "mast": {**MAST, "strength_w": 0}}
        assert images(simulation(off).step_sample(at(0))) == images(none)


def exposure_ev(sample: Sample) -> float:
    return float(json.loads(sample.provenance.exposures_json)["camera"])


class TestExposure:
    """Nights under automatic exposure, whose limits keep them dark."""

    def metered(self, strength_w: float, **render: Any) -> Sample:
        lamps = {"left": {**HEADLIGHT, "strength_w": strength_w}}
        sim = simulation(lamps, render={"auto_exposure": {"max_ev": 6.0}, **render})
        return sim.step_sample(at(0))

    def test_a_stronger_lamp_is_exposed_for_less(self) -> None:
        weak, strong = self.metered(1000.0), self.metered(8000.0)
        assert exposure_ev(weak) - exposure_ev(strong) == pytest.approx(3.0, abs=0.01)
        difference = rgb(weak).astype(int) - rgb(strong)
        assert np.abs(difference).max() <= 1

    def test_a_faint_lamp_meets_the_limit_and_stays_dark(self) -> None:
        faint = self.metered(1.0)
        assert exposure_ev(faint) == 6.0
        fixed = self.metered(1.0, exposure_ev=6.0)
        assert np.array_equal(rgb(faint), rgb(fixed))
        assert 0 < rgb(faint).max() < rgb(self.metered(1000.0)).max() / 2
        dark = self.metered(0.0)
        assert exposure_ev(dark) == 6.0
        assert not rgb(dark).any()

    def test_the_meter_has_no_memory_of_a_switched_lamp(self) -> None:
        sim = simulation({"left": HEADLIGHT}, render={})
        lit = sim.step_sample(at(0))
        off = sim.step_sample(switched(left={"enabled": False}))
        again = sim.step_sample(switched(left={"enabled": True}))
        assert exposure_ev(off) > exposure_ev(lit) == exposure_ev(again)
        assert images(again) == images(lit)

    def test_white_is_balanced_to_lamps_where_the_sun_does_not_shine(self) -> None:
        orange = {"left": {**HEADLIGHT, "color_srgb": [1.0, 0.8, 0.5]}}

        def colors(lamps: Any, environment: Any) -> NDArray[Any]:
            balanced = {"exposure_ev": 0.0, "white_balance": "illuminant"}
            sim = simulation(lamps, environment, render=balanced)
            seen = linear(rgb(sim.step_sample(at(0))) / 255)
            return np.asarray(seen.mean(axis=(0, 1)))

        twilight = {"sun_elevation_deg": -12.0}
        white = colors({"left": {**HEADLIGHT, "color_srgb": [1.0, 1.0, 1.0]}}, NIGHT)
        for environment in (NIGHT, twilight):
            seen = colors(orange, environment)
            np.testing.assert_allclose(seen / seen[1], white / white[1], rtol=0.03)


@pytest.mark.parametrize(
    ("lamps", "field", "expected"),
    [
        ({"a": {}}, "a.position_m", "missing"),
        ({"a": {**MAST, "kind": "laser"}}, "a.kind", "'point', 'spot' or 'area'"),
        ({"a": {**MAST, "frame": "odom"}}, "a.frame", "'map' or 'base_link'"),
        ({"a": {**MAST, "strenght_w": 5}}, "a.strenght_w", "did you mean strength_w"),
        ({"a": {**MAST, "strength_w": -1}}, "a.strength_w", "from 0 to"),
        ({"a": {**MAST, "cone_deg": 30}}, "a.cone_deg", "only spot lamps"),
        ({"a": {**HEADLIGHT, "width_m": 1}}, "a.width_m", "only area lamps"),
        ({"a": {**MAST, "direction": [0, 0, 1]}}, "a.direction", "only spot and area lamps"),
        ({"a": {**HEADLIGHT, "direction": [0, 0, 0]}}, "a.direction", "a vector of a length"),
        ({"a": {**HEADLIGHT, "cone_deg": 200}}, "a.cone_deg", "at most 180"),
        ({"a": {**HEADLIGHT, "on_ground": True}}, "a.on_ground", "false for a lamp in base_link"),
        ({"a": {**MAST, "color_srgb": [255, 0, 0]}}, "a.color_srgb.0", "at most 1"),
        ({"a b": MAST}, "a b", "text that matches"),
        ({f"lamp_{i}": MAST for i in range(MAX_LAMPS + 1)}, "lamps", f"at most {MAX_LAMPS}"),
        ([MAST], "lamps", "a mapping"),
    ],
)
def test_wrong_lamps_are_refused_by_their_path(lamps: Any, field: str, expected: str) -> None:
    with pytest.raises(ConfigError) as refused:
        config_from_mapping({"environment": {"lamps": lamps}})
    assert field in str(refused.value)
    assert expected in str(refused.value)
    sim = simulation({})
    with pytest.raises(InvalidInputError) as at_sample:
        sim.step_sample(ModuleMetadata(environment={"lamps": lamps}))
    assert at_sample.value.field.startswith("metadata.environment.lamps")
    assert not sim.scene.lamps


def test_a_mistyped_lamp_is_not_taken_for_a_new_one() -> None:
    sim = simulation({"headlight": HEADLIGHT})
    wrong = {"headlihgt": {"enabled": False}}
    for step in (sim.step_sample, sim.step_batch):
        with pytest.raises(InvalidInputError, match="did you mean headlight") as refused:
            step(ModuleMetadata(environment={"lamps": wrong}))
        assert refused.value.field == "metadata.environment.lamps.headlihgt"


def test_a_lamp_off_the_stage_has_no_ground() -> None:
    far = {**MAST, "position_m": [500.0, 0.0, 2.0]}
    sim = simulation({})
    state = sim.state()
    with pytest.raises(InvalidInputError, match="a position on the stage") as refused:
        sim.step_sample(switched(mast=far))
    assert refused.value.field == "environment.lamps.mast.position_m"
    assert sim.state() == state


def test_the_example_is_lit_by_its_lamps_alone() -> None:
    """By the analytic backend here, by Blender with all other examples."""
    config = load_config(REPOSITORY / "config/examples/environment_lamps.yaml")
    sim = Simulation(adjust(config, backend="analytic", size="64x48"))
    sim.step_batch()
    lit = rgb(sim.step_sample())
    names = [lamp.name for lamp in sim.scene.lamps]
    assert names == ["headlight_left", "headlight_right", "work_light"]
    assert lit.mean() > 20
    off = {name: {"enabled": False} for name in names}
    assert not rgb(sim.step_sample(ModuleMetadata(environment={"lamps": off}))).any()
