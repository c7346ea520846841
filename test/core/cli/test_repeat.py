"""A sample's record alone renders the sample again, whatever came before it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from commands import oaisys, oaisys_here

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_core.output.images import read_image, write_image
from oaisys_core.simulation import Simulation
from oaisys_core.types import Frame, ModuleMetadata, PinholeIntrinsics, Pose, Sample
from oaisys_core.world.batch import MAX_METADATA_BYTES

CAMERA: dict[str, Any] = {
    "width_px": 24,
    "height_px": 18,
    "fx_px": 20.0,
    "fy_px": 20.0,
    "modalities": ["rgb", "depth", "semantic_0", "instance", "normal", "flow"],
    "lens": {"focus_distance_m": 5.0, "f_number": 4.0},
    "shutter_share": 0.25,
}
WORLD: dict[str, Any] = {
    "seed": 11,
    "backend": "analytic",
    "stage": {
        "surroundings": "plain",
        "preset": "mounds",
        "extent_m": 40.0,
        "resolution_px": 65,
        "detail": {},
    },
    "materials": {"texture_size_px": 32, "mask": {"size_px": 32, "relief": 0}},
    "assets": {
        "rocks": [{"kind": "angular", "count": [12, 12], "variants": 1}],
        "groups": [
            {
                "name": "stones",
                "label": "stone",
                "semantic_id": 50,
                "shape": "rounded",
                "count": [5, 9],
                "size_m": [0.3, 1.0],
            }
        ],
        "movers": [
            {
                "name": "rover",
                "label": "rover",
                "semantic_id": 51,
                "shape": "rover",
                "trajectory": {"waypoints_m": [[-8, -8], [8, -8], [0, 8]], "closed": True},
            }
        ],
    },
    "environment": {
        "sun_elevation_deg": [20, 60],
        "haze": {"visibility_m": 300.0, "color_srgb": [1.0, 0.5, 0.25]},
        "lamps": {
            "headlight": {"kind": "spot", "frame": "base_link", "position_m": [0.3, 0, 0]},
            "mast": {"position_m": [0, 0, 3], "on_ground": True, "strength_w": [50, 500]},
        },
        "redraw": "sample",
    },
    "sensors": {
        "cameras": [
            {"name": "left", **CAMERA},
            {"name": "right", **CAMERA, "mount_position_m": [0, -0.4, 0], "step_interval": 2},
        ],
        "pose_policy": "clamp",
    },
    "render": {"effects": {"sensor_noise": {}}},
}


def pose(rng: np.random.Generator) -> Pose:
    x, y = rng.uniform(-12, 12, 2)
    yaw, down = rng.uniform(-np.pi, np.pi), rng.uniform(0.3, 1.2)
    cy, sy, cp, sp = np.cos(yaw / 2), np.sin(yaw / 2), np.cos(down / 2), np.sin(down / 2)
    quat = (float(-sy * sp), float(cy * sp), float(sy * cp), float(cy * cp))
    return Pose((float(x), float(y), float(rng.uniform(2, 12))), quat)


def environment(rng: np.random.Generator) -> dict[str, Any]:
    changes: list[dict[str, Any]] = [
        {"sun_elevation_deg": float(rng.uniform(5, 80))},
        {"haze": None},
        {"haze": {"visibility_m": float(rng.uniform(50, 500))}},
        {"redraw": "batch"},
        {"ground_beyond_label": {"label": "plain", "semantic_id": 77}},
        {"sky": {"model": "gradient"}},
    ]
    return changes[rng.integers(len(changes))]


def sensor(rng: np.random.Generator) -> dict[str, Any]:
    name = ("left", "right")[rng.integers(2)]
    changes: list[dict[str, Any]] = [
        {"lens": None},
        {"lens": {"f_number": float(rng.uniform(1, 9))}},
        {"fx_px": float(rng.uniform(15, 30)), "fy_px": float(rng.uniform(15, 30))},
        {"distortion": {"k1": float(rng.uniform(-0.1, 0.1))}},
        {"distortion": None},
    ]
    return {"cameras": {name: changes[rng.integers(len(changes))]}}


def asset(rng: np.random.Generator, seen: list[int]) -> dict[str, Any]:
    name = f"thing{rng.integers(3)}"
    x, y = (float(value) for value in rng.uniform(-10, 10, 2))
    some = str(seen[rng.integers(len(seen))]) if seen else None
    changes: list[dict[str, Any]] = [
        {"add": {name: {**LABEL, "shape": "slab", "scale": 1.5, "position_m": [x, y, 3.0]}}},
        {"add": {name: {**LABEL, "prototype": "stones", "position_m": [x, y, 2.0]}}},
        {"add": {name: None}},
        {"groups": {"stones": {"scale": float(rng.uniform(0.5, 3))}}},
        {"groups": {"stones": {"hidden": bool(rng.integers(2))}}},
        {"groups": {"stones": None}},
    ]
    if some is not None:
        changes += [
            {"objects": {some: {"position_m": [x, y, 4.0]}}},
            {"objects": {some: {"hidden": True}}},
            {"objects": {some: {"scale": 2.5}}},
            {"objects": {some: None}},
        ]
    return changes[rng.integers(len(changes))]


SOAK = [pytest.param(seed, marks=pytest.mark.soak) for seed in (1, 2, 3)]
LABEL = {"label": "thing", "semantic_id": 60}


def render(rng: np.random.Generator) -> dict[str, Any]:
    changes: list[dict[str, Any]] = [
        {"exposure_ev": float(rng.uniform(-1, 1))},
        {"effects": {"vignetting": float(rng.uniform(0, 1))}},
        {"effects": {"sensor_noise": None}},
        {"effects": {"sensor_noise": {"full_well_e": 900.0}}},
        {"quality": "preview"},
        {"time_budget_s": 0.5},
    ]
    return changes[rng.integers(len(changes))]


def stage(rng: np.random.Generator) -> dict[str, Any]:
    changes: list[dict[str, Any]] = [
        {"stage": {"relief_m": float(rng.uniform(1, 5))}},
        {"stage": {"save_as": "kept"}},
        {"stage": {"reuse": {"name": "kept", "objects": "keep"}}},
        {"stage": {"reuse": {"name": "kept", "objects": "redraw"}}},
        {"stage": {"reuse": {"name": "kept", "objects": "clear"}}},
        {"materials": {"seed": int(rng.integers(99))}},
    ]
    return changes[rng.integers(len(changes))]


def images(sample: Sample) -> dict[tuple[str, str], bytes]:
    """All but the flow, which tells of the world at the previous sample, too."""
    return {(f.sensor, f.modality): f.data.tobytes() for f in sample.frames if f.modality != "flow"}


def maybe(rng: np.random.Generator, draw: Callable[[], dict[str, Any]]) -> dict[str, Any] | None:
    return draw() if rng.random() < 0.5 else None


def step(sim: Simulation, rng: np.random.Generator, seen: list[int]) -> Sample:
    """Do something that a client may do, and return a sample after it."""
    if rng.random() < 0.3:
        metadata = ModuleMetadata(
            sensor=maybe(rng, lambda: sensor(rng)),
            environment=maybe(rng, lambda: environment(rng)),
            asset=maybe(rng, lambda: {"count_factor": float(rng.uniform(0.3, 2))}),
            render=maybe(rng, lambda: render(rng)),
            custom=maybe(rng, lambda: stage(rng)) or {},
        )
        reuses = not set(metadata.custom) and rng.random() < 0.5
        sim.step_batch(metadata, reuse_stage=reuses)
        seen.clear()
    where = {"pose": pose(rng)} if rng.random() < 0.8 else {}
    metadata = ModuleMetadata(
        sensor={**(maybe(rng, lambda: sensor(rng)) or {}), **where},
        environment=maybe(rng, lambda: environment(rng)),
        asset=maybe(rng, lambda: asset(rng, seen)),
        render=maybe(rng, lambda: render(rng)),
    )
    modalities = ("depth", "instance") if rng.random() < 0.2 else ()
    return sim.step_sample(metadata, modalities=modalities)


@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.long), *SOAK])
def test_the_newest_record_alone_repeats_its_sample(seed: int, tmp_path: Path) -> None:
    config = config_from_mapping({**WORLD, "stage": {**WORLD["stage"], "store": str(tmp_path)}})
    rng = np.random.default_rng(seed)
    sim, other = Simulation(config), Simulation(config)
    sim.step_batch(ModuleMetadata(custom={"stage": {"save_as": "kept"}}))
    seen: list[int] = []
    repeated = refused = 0
    while repeated < 7:
        try:
            sample = step(sim, rng, seen)
        except InvalidInputError:
            refused += 1
            assert refused < 100
            continue
        for frame in sample.frames:
            if frame.modality == "instance":
                seen += [int(i) for i in np.unique(frame.data) if i and int(i) not in seen]
        again = other.repeat(sample.outline)
        assert again.rig_pose == sample.rig_pose
        assert again.provenance.metadata_json == sample.provenance.metadata_json
        assert images(again) == images(sample), sample.provenance
        repeated += 1


def test_a_pose_that_normalising_twice_would_change_repeats_to_its_last_digit() -> None:
    camera = {**CAMERA, "name": "left", "modalities": ["depth"], "lens": None, "shutter_share": 0.0}
    sections = {"assets": {}, "sensors": {"cameras": [camera], "pose_policy": "allow"}}
    sim, other = (world(stage={"preset": "plane", "resolution_px": 17}, **sections) for _ in "ab")
    found = 0
    for quat in np.random.default_rng(2).normal(size=(500, 4)):
        given = 1.0005 * quat / np.linalg.norm(quat)
        once = given / np.linalg.norm(given)
        if found == 3 or np.array_equal(once / np.linalg.norm(once), once):
            continue
        found += 1
        wanted = Pose((1.0, 2.0, 4.0), tuple(given.tolist()))
        sample = sim.step_sample(ModuleMetadata(sensor={"pose": wanted}))
        assert sample.rig_pose.quat_xyzw == tuple(once.tolist())
        again = other.repeat(sample.outline)
        assert again.rig_pose == sample.rig_pose
        assert images(again) == images(sample)
    assert found == 3


def world(**sections: Any) -> Simulation:
    sim = Simulation(config_from_mapping({**WORLD, **sections}))
    sim.step_batch()
    return sim


def test_a_mapping_after_null_is_not_mixed_with_the_configuration() -> None:
    """If metadata were merged key by key, the haze would get its configured colour again."""
    sim, other = world(), world()
    for haze in (None, {"visibility_m": 60.0}):
        sample = sim.step_sample(ModuleMetadata(environment={"haze": haze}))
    told = json.loads(sample.provenance.metadata_json)
    assert told["environment"]["haze"]["color_srgb"] == [1.0, 1.0, 1.0]
    assert images(other.repeat(sample.outline)) == images(sample)
    resumed = world()
    resumed.restore(json.loads(json.dumps(sim.state())))
    assert images(resumed.step_sample()) == images(sim.step_sample())


def test_a_stage_is_recorded_by_its_hash_not_by_its_name(tmp_path: Path) -> None:
    config = {**WORLD["stage"], "store": str(tmp_path)}
    sim, other = world(stage=config), world(stage=config)
    sim.step_batch(ModuleMetadata(custom={"stage": {"save_as": "kept"}}))
    sim.step_batch()
    sim.step_batch(ModuleMetadata(custom={"stage": {"reuse": {"name": "kept", "objects": "keep"}}}))
    sample = sim.step_sample()
    how = sample.provenance
    assert how.stage_seed == how.asset_seed != how.batch_seed
    sim.step_batch(ModuleMetadata(custom={"stage": {"save_as": "kept"}}))
    assert images(other.repeat(sample.outline)) == images(sample)


def test_the_record_of_a_revisited_view_says_how_it_came_about_there() -> None:
    sim = Simulation(config_from_mapping({**WORLD, "render": {}}), pose_cache_bytes=10**7)
    sim.step_batch()
    asked = ("depth", "semantic_0", "instance")
    sim.step_sample(ModuleMetadata(environment={"sky_strength": 0.5}), modalities=asked)
    sim.step_sample(ModuleMetadata(environment={"sky_strength": 1.0}), modalities=asked)
    again = sim.step_sample(ModuleMetadata(environment={"sky_strength": 0.5}), modalities=asked)
    assert json.loads(again.provenance.metadata_json)["environment"] == {"sky_strength": [0.5, 0.5]}


def test_metadata_in_force_is_bounded(tmp_path: Path) -> None:
    sky = tmp_path / "sky.png"
    cv2.imwrite(str(sky), np.full((4, 8, 3), 128, np.uint8))
    sim = world()
    sim.step_sample()
    taken = 0

    def grow(count: int) -> None:
        nonlocal taken
        for level in range(count):
            images = [{"file": str(sky), "label": "x" * 1000}] * (200 * level) or [
                {"file": str(sky)}
            ]
            metadata = ModuleMetadata(environment={"hdri": {"images": images}})
            sim.step_sample(metadata, modalities=["depth"])
            taken = level

    with pytest.raises(InvalidInputError, match=rf"metadata: .*at most {MAX_METADATA_BYTES} bytes"):
        grow(8)
    assert taken == 4
    assert sim.info().sample_id == 1 + taken + 1  # what was refused changed nothing
    assert world().repeat(sim.step_sample().outline).sample_id == sim.info().sample_id


def test_another_configuration_is_refused() -> None:
    sample = world().step_sample()
    with pytest.raises(InvalidInputError, match="config_sha256"):
        world(seed=12).repeat(sample.outline)


def test_a_record_of_an_earlier_version_is_refused() -> None:
    sim = world()
    outline = sim.step_sample().outline
    old = replace(outline, provenance=replace(outline.provenance, metadata_json=""))
    with pytest.raises(InvalidInputError, match="metadata_json"):
        sim.repeat(old)


def frame_of(depth_m: np.ndarray) -> Frame:
    intrinsics = PinholeIntrinsics(depth_m.shape[1], depth_m.shape[0], 1.0, 1.0, 0.0, 0.0)
    return Frame("left", "depth", depth_m, intrinsics, np.eye(4))


STEPS = """
batch: {asset: {count_factor: 1.5}}
samples:
- {sensor: {pose: {position_m: [1, 2, 9], quat_xyzw: [0, 0.5, 0, 0.8660254037844386]}}}
- {environment: {sun_elevation_deg: 12}, asset: {groups: {stones: {scale: 2}}}}
- {sensor: {cameras: {left: {fx_px: 25}}}}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `oaisys render` writes of two worlds of three samples."""
    top = tmp_path_factory.mktemp("rendered")
    (top / "world.yaml").write_text(json.dumps(WORLD))
    (top / "steps.yaml").write_text(STEPS)
    steps = ("--metadata", top / "steps.yaml", "--batches", 2, "--batch-offset", 4)
    done = oaisys_here("render", "--config", top / "world.yaml", "--out", top / "out", *steps)
    assert done.returncode == 0, done.stderr
    return top / "out"


def sample_file(folder: Path, batch: int, sample: int) -> Path:
    return folder / f"batch_{batch + 4:04d}/meta_data/sample_data/{sample:04d}.json"


@pytest.mark.long
def test_repeat_finds_every_sample_of_a_folder_equal(folder: Path) -> None:
    done = oaisys("repeat", folder, "--all")
    assert done.returncode == 0, done.stdout + done.stderr
    heads = [line for line in done.stdout.splitlines() if line.startswith("batch")]
    assert heads == [f"batch {b} sample {s}: equal" for b in (1, 2) for s in (1, 2, 3)]
    assert "left/depth: equal, 432 pixels" in done.stdout


@pytest.mark.long
def test_repeat_takes_the_newest_or_the_one_named(
    folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for arguments, found in (
        ((folder,), "batch 2 sample 3"),
        ((folder, "--sample", "1/2"), "batch 1 sample 2"),
        ((sample_file(folder, 1, 2),), "batch 1 sample 2"),
    ):
        assert oaisys_here("repeat", *arguments).returncode == 0
        assert f"{found}: equal" in capfd.readouterr().out
    refused = oaisys_here("repeat", folder, "--sample", "3/1")
    assert refused.returncode == 2
    assert "1/1 to 2/3" in refused.stderr


def test_repeat_tells_a_pixel_that_differs(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = next((folder / "batch_0006/left").glob("0003*depth_00.exr"))
    kept = file.read_bytes()
    try:
        depth_m = read_image(file, "depth")
        depth_m[3, 4] = np.nextafter(depth_m[3, 4], np.float32(0))
        write_image(file, frame_of(depth_m))
        done = oaisys_here("repeat", folder)
    finally:
        file.write_bytes(kept)
    assert done.returncode == 1
    assert "left/depth: 1 of 432 pixels differ" in capfd.readouterr().out
    assert "1 of 1 samples differ from the record" in done.stderr


@pytest.mark.long
def test_repeat_needs_the_same_configuration(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "other.yaml").write_text(json.dumps({**WORLD, "seed": 12}))
    done = oaisys_here("repeat", folder, "--config", tmp_path / "other.yaml")
    assert done.returncode == 2
    assert "sha256" in done.stderr
    config = folder / "config.yaml"
    config.rename(tmp_path / "config.yaml")
    try:
        without = oaisys_here("repeat", folder)
        given = oaisys_here("repeat", folder, "--config", tmp_path / "config.yaml")
    finally:
        (tmp_path / "config.yaml").rename(config)
    assert (without.returncode, given.returncode) == (2, 0)
    assert "--config FILE" in without.stderr


@pytest.mark.long
def test_repeat_refuses_what_is_no_record(tmp_path: Path) -> None:
    (tmp_path / "some.json").write_text("{}")
    for path in (tmp_path / "none", tmp_path, tmp_path / "some.json"):
        done = oaisys_here("repeat", path)
        assert done.returncode == 2, done.stdout
        assert "Traceback" not in done.stderr


@pytest.mark.long
@pytest.mark.blender
def test_blender_repeats_noise_light_and_additions(tmp_path: Path) -> None:
    camera = {**CAMERA, "width_px": 64, "height_px": 48, "lens": None, "shutter_share": 0.0}
    camera |= {"name": "left", "modalities": ["rgb", "depth", "semantic_0", "instance", "normal"]}
    config = {**WORLD, "backend": "blender", "render": {"quality": "preview"}}
    config["stage"] = {**WORLD["stage"], "detail": {"radius_m": 2.0, "spacing_m": 0.1}}
    config["sensors"] = {"cameras": [camera], "faults": {"depth_noise": "kinect"}}
    add = "{slab1: {label: thing, semantic_id: 60, shape: slab, position_m: [2, 2, 4]}}"
    steps = [STEPS.strip(), f"- {{asset: {{add: {add}}}, environment: {{haze: null}}}}", ""]
    (tmp_path / "world.yaml").write_text(json.dumps(config))
    (tmp_path / "steps.yaml").write_text("\n".join(steps))
    given = ("--config", tmp_path / "world.yaml", "--metadata", tmp_path / "steps.yaml")
    rendered = oaisys("render", *given, "--out", tmp_path / "out")
    assert rendered.returncode == 0, rendered.stderr
    done = oaisys("repeat", tmp_path / "out", "--all")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count(": equal, 3072 pixels") >= 16
