"""Packages that add modules, stages, effects, shapes and passes, in processes of their own."""

from __future__ import annotations

import configparser
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from repository import REPOSITORY

from oaisys_core.output.exr import read_channels
from oaisys_core.output.reader import read_sample
from oaisys_core.types import Sample

EXAMPLES = REPOSITORY / "examples/extensions"
KINDS = sorted(path.parent.name for path in EXAMPLES.glob("*/setup.cfg"))
IN_WORLDS = sorted(path.parent.name for path in EXAMPLES.glob("*/world.yaml"))
"""The examples that a configuration names."""

SMALL = """
backend: analytic
stage: {surroundings: plain, preset: mounds, extent_m: 30, resolution_px: 65}
materials: {texture_size_px: 64, mask: {size_px: 32, relief: 0}}
sensors: {cameras: [{width_px: 64, height_px: 48}]}
assets: {rocks: [{count: [20, 20]}]}
render: {exposure_ev: 0.0}
"""

RUN = """
import sys, yaml
from pathlib import Path
from oaisys_core.config import config_from_mapping
from oaisys_core.output.writer import SampleWriter
from oaisys_core.simulation import Simulation
from oaisys_core.types import merge

small, out, *worlds = sys.argv[1:]
for world in map(Path, worlds):
    data = merge(yaml.safe_load(small), yaml.safe_load(world.read_text()))
    for camera in data["sensors"].get("cameras", []):
        camera.update(width_px=64, height_px=48)
    simulation = Simulation(config_from_mapping(data))
    simulation.step_batch()
    SampleWriter(Path(out, world.parent.name)).write(simulation.step_sample())
"""


def install(folder: Path, points: str, *sources: Path) -> dict[str, str]:
    """Return the environment of a process to which packages with such entry points are known."""
    info = folder / "third_party-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: third_party\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(points)
    found = [*map(str, sources), str(folder), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, found))}


def installed_examples(folder: Path, *kinds: str) -> dict[str, str]:
    setup = configparser.ConfigParser()
    setup.read(EXAMPLES / kind / "setup.cfg" for kind in kinds)  # their points are of other groups
    points = "".join(f"[{g}]\n{v}\n" for g, v in setup["options.entry_points"].items())
    return install(folder, points, *(EXAMPLES / kind for kind in kinds))


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Sample]:
    """Return the first sample of each example's world, and of one without any of them installed.

    Exposure is fixed, because an automatic one would lighten what an effect darkens.
    """
    folder = tmp_path_factory.mktemp("extensions")
    plain = folder / "plain/world.yaml"
    plain.parent.mkdir()
    plain.write_text("{}")
    lines_of(RUN, [SMALL, str(folder / "out"), str(plain)], dict(os.environ))
    worlds = [str(EXAMPLES / kind / "world.yaml") for kind in IN_WORLDS]
    installed = installed_examples(folder, *IN_WORLDS)
    lines_of(RUN, [SMALL, str(folder / "out"), *worlds], installed)
    image = read_channels(folder / "out/pass/batch_0001/camera/0001camera_slope_00.exr")["Y"]
    assert image.shape == (48, 64)
    assert 0 < np.nanmax(image) <= 90
    read = ("plain", *(kind for kind in IN_WORLDS if kind != "pass"))
    return {kind: read_sample(folder / "out" / kind / "batch_0001", 1) for kind in read}


def test_each_kind_has_a_short_example() -> None:
    assert IN_WORLDS == ["environment_effect", "module", "pass", "scatterer", "stage"]
    assert sorted([*IN_WORLDS, "dataset_format"]) == KINDS
    for kind in KINDS:
        (source,) = (EXAMPLES / kind).glob("*.py")
        assert len(source.read_text(encoding="utf-8").splitlines()) <= 45


@pytest.mark.long
def test_a_module_adds_and_leaves_all_else_as_it_was(samples: dict[str, Sample]) -> None:
    sample = samples["module"]
    ids = sample.frame("camera", "semantic_0").data
    assert sample.provenance.batch_seed == samples["plain"].provenance.batch_seed
    assert set(np.unique(ids)) <= {1, 2, 10, 999}


@pytest.mark.long
def test_an_effect_changes_colour_alone(samples: dict[str, Sample]) -> None:
    plain, dimmed = samples["plain"], samples["environment_effect"]
    for modality in ("depth", "semantic_0", "instance"):
        a, b = plain.frame("camera", modality).data, dimmed.frame("camera", modality).data
        assert np.array_equal(a, b)
    assert (
        dimmed.frame("camera", "rgb").data.mean() < 0.8 * plain.frame("camera", "rgb").data.mean()
    )


@pytest.mark.long
def test_a_stage_is_another_ground(samples: dict[str, Sample]) -> None:
    a, b = (samples[kind].frame("camera", "depth").data for kind in ("plain", "stage"))
    assert not np.array_equal(a, b)


@pytest.mark.long
def test_a_shape_is_scattered(samples: dict[str, Sample]) -> None:
    assert 30 in samples["scatterer"].frame("camera", "semantic_0").data


CHECK = """
import sys
from oaisys_core.config import config_from_mapping
from oaisys_core.errors import OaisysError
from oaisys_core.simulation import Simulation
import yaml
for text in sys.argv[1:]:
    try:
        Simulation(config_from_mapping(yaml.safe_load(text)))
        print("fine")
    except OaisysError as error:
        print(str(error).replace(chr(10), " "))
"""


def lines_of(code: str, arguments: list[str], environment: dict[str, str]) -> list[str]:
    """Return what a program prints with some packages installed."""
    command = [sys.executable, "-c", code, *arguments]
    ran = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.splitlines()


def test_faults_name_the_package_and_others_still_load(tmp_path: Path) -> None:
    points = (
        "[oaisys.modules]\nbroken = no_such_library:Thing\nrender = no_such_library:Thing\n"
        "wrong = json:dumps\n[oaisys.stages]\nterraces = terraces:terraces\n"
        "[oaisys.environment_effects]\nnight = no_such_library:Night\n"
    )
    environment = install(tmp_path, points, EXAMPLES / "stage")
    texts = [
        "{backend: analytic, stage: {preset: terraces}}",
        "{backend: analytic, extensions: {broken: {}}}",
        "{backend: analytic, extensions: {render: {}}}",
        "{backend: analytic, extensions: {missing: {}}}",
        "{backend: analytic, extensions: {wrong: {}}}",
        "{backend: analytic, stage: {preset: terrace}}",
        "{backend: analytic, environment: {effects: [{effect: night}]}}",
        "{backend: analytic, sensors: {cameras: [{modalities: [slope]}]}}",
    ]
    told = lines_of(CHECK, texts, environment)
    parts = [
        ["fine"],
        ["oaisys.modules", "'broken'", "third_party", "no_such_library"],
        ["extensions.render", "built-in"],
        ["'missing'", "broken"],
        ["extensions.wrong", "ExtensionModule"],
        ["stage.preset", "'terrace'", "terraces"],
        ["'night'", "third_party", "no_such_library"],
        ["modalities", "slope"],
    ]
    assert len(told) == len(parts)
    for line, expected in zip(told, parts, strict=True):
        assert all(part in line for part in expected), line


PASSES = """
import sys, yaml
from oaisys_core.config import config_from_mapping
from oaisys_core.simulation import Simulation
from oaisys_core.types import merge

small = yaml.safe_load(sys.argv[1])
small["sensors"]["cameras"][0]["modalities"] = ["rgb", "slope"]
for render in ({"quality": "geometry"}, {"passes": ["slope"]}):
    simulation = Simulation(config_from_mapping(merge(small, {"render": render})))
    simulation.step_batch()
    print(*(frame.modality for frame in simulation.step_sample().frames))
"""


def test_a_pass_needs_no_colour(tmp_path: Path) -> None:
    lines = lines_of(PASSES, [SMALL], installed_examples(tmp_path, "pass"))
    assert lines == ["slope", "slope"]


def test_options_of_a_module_are_checked(tmp_path: Path) -> None:
    environment = installed_examples(tmp_path, "module")
    texts = ["{backend: analytic, extensions: {flag: {size: 1}}}"]
    told = lines_of(CHECK, texts, environment)
    assert "extensions.flag.size" in told[0]
