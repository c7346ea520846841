"""The two verbs on the analytic backend: draws, metadata, refusals, restoring."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from oaisys_core.config import SimulationConfig, config_from_mapping
from oaisys_core.errors import CancelledError, ConfigError, InvalidInputError, NotReadyError
from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, Pose, Progress, Sample
from oaisys_core.world.extension_modules import ExtensionModule, NoOptions
from oaisys_core.world.module import Metadata, World

WORLD: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"extent_m": 24, "resolution_px": 65, "surroundings": "plain"},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 64, "relief": 0}},
    "assets": {"rocks": [{"count": [20, 40], "variants": 2}]},
    "sensors": {"cameras": [{"width_px": 64, "height_px": 48, "fx_px": 54.114, "fy_px": 54.114}]},
}
POSES = [pose_looking_down(1, 1, 11, 0.4), pose_looking_at((-6, -5, 7), (2, 3, 0))]


def world(**changes: Any) -> SimulationConfig:
    return config_from_mapping({**WORLD, **changes})


def at(pose: Pose) -> ModuleMetadata:
    return ModuleMetadata(sensor={"pose": pose})


def labels_of(sample: Sample) -> list[bytes]:
    return [f.data.tobytes() for f in sample.frames if f.modality != "rgb"]


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    simulation = Simulation(world())
    simulation.step_batch()
    return simulation


def test_a_sample_before_a_batch_is_refused() -> None:
    with pytest.raises(NotReadyError):
        Simulation(world()).step_sample()


def test_a_sample_has_all_modalities_in_their_types(simulation: Simulation) -> None:
    sample = simulation.step_sample(at(POSES[1]))
    kinds = {f.modality: (f.data.dtype.name, f.data.shape) for f in sample.frames}
    assert kinds == {
        "rgb": ("uint8", (48, 64, 3)),
        "depth": ("float32", (48, 64)),
        "semantic_0": ("uint16", (48, 64)),
        "instance": ("uint32", (48, 64)),
    }
    assert sample.rig_pose == POSES[1]
    labels = set(np.unique(sample.frame("camera", "semantic_0").data))
    assert labels <= {0, *simulation.info().semantic_labels}


def test_equal_seeds_give_equal_bytes_and_others_do_not() -> None:
    def run(seed: int) -> list[list[bytes]]:
        simulation = Simulation(world(seed=seed))
        simulation.step_batch()
        return [labels_of(simulation.step_sample(at(pose))) for pose in POSES]

    first = run(5)
    assert first == run(5)
    assert first != run(6)


def test_a_batch_is_repeated_by_the_seed_in_its_provenance() -> None:
    simulation = Simulation(world())
    simulation.step_batch()
    simulation.step_batch()
    sample = simulation.step_sample(at(POSES[0]))
    simulation.step_batch(seed=sample.provenance.batch_seed)
    assert labels_of(simulation.step_sample(at(POSES[0]))) == labels_of(sample)


def test_a_reused_stage_keeps_the_ground_and_draws_new_rocks() -> None:
    simulation = Simulation(world())
    simulation.step_batch()
    grid = np.random.default_rng(0).uniform(-10, 10, (50, 3))
    before = simulation.query_height(grid)
    rocks_before = simulation.step_sample(at(POSES[0])).frame("camera", "instance").data
    assert simulation.step_batch(reuse_stage=True) == 2
    after = simulation.query_height(grid)
    rocks_after = simulation.step_sample(at(POSES[0])).frame("camera", "instance").data
    assert np.array_equal(before.ground_height_m, after.ground_height_m)
    assert not np.array_equal(rocks_before, rocks_after)
    simulation.step_batch()
    changed = simulation.query_height(grid)
    assert not np.array_equal(before.ground_height_m, changed.ground_height_m)


def test_a_batch_that_is_refused_or_stopped_while_it_is_drawn_leaves_the_old_world() -> None:
    simulation = Simulation(world())
    simulation.step_batch(ModuleMetadata(environment={"sun_elevation_deg": 12}))
    before = simulation.step_sample(at(POSES[0]))
    state = json.loads(json.dumps(simulation.state()))
    outside = {"shape": "boulder", "label": "far", "semantic_id": 99}
    outside |= {"position_m": [40, 0, 0], "on_ground": True}
    with pytest.raises(InvalidInputError, match="position_m"):
        simulation.step_batch(ModuleMetadata(asset={"add": {"far": outside}}))

    def stop(progress: Progress) -> None:
        if progress.fraction > 0:
            raise CancelledError("stopped")

    with pytest.raises(CancelledError):
        simulation.step_batch(progress=stop)

    assert simulation.state() == state
    after = simulation.step_sample(at(POSES[0]))
    assert (after.batch_id, after.sample_id) == (1, 2)
    assert labels_of(after) == labels_of(before)
    assert simulation.step_batch() == 2


def test_a_restored_simulation_goes_on_with_the_same_bytes() -> None:
    first = Simulation(world())
    first.step_batch()
    first.step_batch(ModuleMetadata(asset={"count_factor": 0.5}), reuse_stage=True)
    first.step_sample(
        ModuleMetadata(sensor={"pose": POSES[0]}, environment={"sun_elevation_deg": 12})
    )
    state = json.loads(json.dumps(first.state()))
    second = Simulation(world())
    second.restore(state)
    assert second.state() == state
    a, b = first.step_sample(), second.step_sample()
    assert [f.data.tobytes() for f in a.frames] == [f.data.tobytes() for f in b.frames]
    assert (a.batch_id, a.sample_id) == (b.batch_id, b.sample_id) == (2, 2)
    assert first.step_batch() == second.step_batch() == 3


def test_after_a_withdrawn_sample_all_is_as_if_it_had_not_been() -> None:
    cameras = [{**WORLD["sensors"]["cameras"][0], "modalities": ["depth", "rgb", "flow"]}]
    simulations = [Simulation(world(sensors={"cameras": cameras})) for _ in range(2)]
    for simulation in simulations:
        simulation.step_batch()
        simulation.step_sample(at(POSES[0]))
    detour = simulations[1]
    state = json.loads(json.dumps(detour.state()))
    elsewhere = ModuleMetadata(sensor={"pose": POSES[1]}, environment={"sun_elevation_deg": 12})
    assert detour.step_sample(elsewhere).sample_id == 2
    detour.withdraw_sample()
    assert detour.state() == state
    with pytest.raises(NotReadyError, match="withdraw"):
        detour.withdraw_sample()
    a, b = (s.step_sample(at(pose_looking_down(1.2, 1, 11, 0.4))) for s in simulations)
    assert a.sample_id == b.sample_id == 2
    assert np.isfinite(a.frame("camera", "flow").data).any()
    assert [f.data.tobytes() for f in a.frames] == [f.data.tobytes() for f in b.frames]


@pytest.mark.parametrize(
    ("metadata", "field"),
    [
        (ModuleMetadata(sensor={"pose": Pose((0, 0, -5), (0, 0, 0, 1))}), "pose.position"),
        (ModuleMetadata(sensor={"pose": Pose((0, 500, 5), (0, 0, 0, 1))}), "pose.position"),
        (ModuleMetadata(sensor={"pose": Pose((0, 0, 5), (0, 0, 0, 0))}), "orientation"),
        (ModuleMetadata(sensor={"place": 1}), "metadata.sensor.place"),
        (ModuleMetadata(environment={"sun": 1}), "metadata.environment.sun"),
        (ModuleMetadata(environment={"sun_elevation_deg": 200}), "sun_elevation_deg"),
        (ModuleMetadata(render={"quality": "cinema"}), "metadata.render.quality"),
        (ModuleMetadata(asset={"count_factor": 2}), "metadata.asset"),
        (ModuleMetadata(custom={"weather": {}}), "metadata.custom.weather"),
        (ModuleMetadata(custom={"render": {}}), "metadata.custom.render"),
        (ModuleMetadata(custom={"stage": [1]}), "metadata.custom.stage"),
    ],
)
def test_refused_metadata_changes_nothing(
    simulation: Simulation, metadata: ModuleMetadata, field: str
) -> None:
    simulation.step_sample(at(POSES[0]))
    before = simulation.state()
    with pytest.raises(InvalidInputError) as caught:
        simulation.step_sample(metadata)
    assert field in caught.value.field
    assert simulation.state() == before


@pytest.mark.parametrize("names", [{"sensors": ["left"]}, {"modalities": ["smell"]}], ids=str)
def test_unknown_sensors_and_modalities_are_refused(
    simulation: Simulation, names: dict[str, Any]
) -> None:
    with pytest.raises(InvalidInputError):
        simulation.step_sample(**names)


def test_modalities_can_be_chosen(simulation: Simulation) -> None:
    sample = simulation.step_sample(modalities=["depth"])
    assert [frame.modality for frame in sample.frames] == ["depth"]
    assert sample.provenance.render_samples == 0


def test_clearance_is_told_and_clamped() -> None:
    clamping = world(sensors={**WORLD["sensors"], "pose_policy": "clamp", "min_clearance_m": 0.5})
    simulation = Simulation(clamping)
    simulation.step_batch()
    sample = simulation.step_sample(at(Pose((50, 3, -9), (0, 0, 0, 1))))
    position_m = np.array([sample.rig_pose.position_m])
    assert position_m[0, 0] == pytest.approx(12.0)
    assert simulation.query_height(position_m).clearance_m[0] == pytest.approx(0.5, abs=1e-4)


def test_a_sample_may_bring_its_own_pose_policy() -> None:
    simulation = Simulation(world())
    simulation.step_batch()
    outside = Pose((50, 3, -9), (0, 0, 0, 1))

    def moved(**sensor: str) -> tuple[float, float, float]:
        return simulation.step_sample(
            ModuleMetadata(sensor={"pose": outside, **sensor})
        ).rig_pose.position_m

    assert moved(pose_policy="clamp")[0] == pytest.approx(12.0)
    assert moved(pose_policy="allow") == outside.position_m
    with pytest.raises(InvalidInputError, match=r"pose\.position"):  # for that sample only
        moved()
    with pytest.raises(InvalidInputError, match=r"pose_policy.*lift"):
        moved(pose_policy="lift")


def test_adding_rocks_does_not_change_the_ground() -> None:
    bare = Simulation(world(assets={"rocks": []}))
    bare.step_batch()
    rocky = Simulation(world())
    rocky.step_batch()
    points_m = np.random.default_rng(1).uniform(-10, 10, (40, 3))
    assert np.array_equal(
        bare.query_height(points_m).ground_height_m, rocky.query_height(points_m).ground_height_m
    )


def test_rocks_raise_the_surface_over_the_ground(simulation: Simulation) -> None:
    x, y = np.meshgrid(np.linspace(-11, 11, 60), np.linspace(-11, 11, 60))
    heights = simulation.query_height(np.column_stack((x.ravel(), y.ravel(), 0 * x.ravel())))
    above_m = heights.surface_height_m - heights.ground_height_m
    assert above_m.min() > -1e-4
    assert above_m.max() > 0.05


@pytest.mark.parametrize(
    "section",
    [{"stage": {"preset": "ocean"}}, {"assets": {"rocks": [{"kind": "cube"}]}}],
)
def test_unknown_presets_and_kinds_are_config_errors(section: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="expected one of"):
        Simulation(world(**section))


class Idle(ExtensionModule):
    name = "idle"

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        pass


def test_a_sample_steps_the_modules_that_it_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = Simulation(world())
    simulation.step_batch()
    stepped: list[str] = []
    for module in simulation._modules.all:

        def step(*args: Any, name: str = module.name, original: Any = module.step_sample) -> None:
            stepped.append(name)
            original(*args)

        monkeypatch.setattr(module, "step_sample", step)

    def stepped_by(metadata: ModuleMetadata) -> list[str]:
        stepped.clear()
        simulation.step_sample(metadata, modalities=["depth"])
        return list(stepped)

    assert stepped_by(at(POSES[0])) == ["sensors"]
    assert stepped_by(ModuleMetadata(render={"exposure_ev": 1})) == ["sensors", "render"]
    hourly = {"redraw": "sample", "sun_elevation_deg": [10, 80]}
    assert stepped_by(ModuleMetadata(environment=hourly)) == ["environment", "sensors"]
    assert stepped_by(ModuleMetadata()) == ["environment", "sensors"]
    # A module of another package may change what the others have set.
    modules = simulation._modules
    simulation._modules = replace(modules, all=(*modules.all, Idle(NoOptions())))
    assert stepped_by(ModuleMetadata()) == [module.name for module in modules.all]
