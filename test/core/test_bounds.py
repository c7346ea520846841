"""Numbers at the edge of what floats can hold: refused with their bounds, or rendered in time."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from oaisys_core.config import config_from_mapping
from oaisys_core.config.sections.sensing.cameras import CameraConfig, optics_bounds_px
from oaisys_core.errors import CancelledError, ConfigError, InvalidInputError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.raycast.clearance import MAX_EXTENTS
from oaisys_core.raycast.view import BAND_PIXELS, bands
from oaisys_core.simulation import Simulation
from oaisys_core.system.ending.interruption import interruptible, stop_if_unwanted
from oaisys_core.types import ModuleMetadata, Pose

WIDTH_PX = 64
EXTENT_M = 24.0
WORLD: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"surroundings": "plain", "extent_m": EXTENT_M, "resolution_px": 65},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 64}},
    "assets": {"rocks": [{"count": [20, 40]}]},
    "sensors": {
        "pose_policy": "allow",
        "cameras": [{"width_px": WIDTH_PX, "height_px": 48, "fx_px": 54.0, "fy_px": 54.0}],
    },
}
IN_TIME_S = 20.0
"""For a view of 64x48 pixels; hundredths of a second on a machine that does nothing else."""

LARGEST, SMALLEST, DENORMAL = 1.7e308, 1e-300, 5e-324
EDGES = [LARGEST, 1e300, 1e30, 1e15, 1e8, 1e-8, 1e-30, SMALLEST, DENORMAL]


@pytest.fixture(scope="module")
def simulation() -> Iterator[Simulation]:
    simulation = Simulation(config_from_mapping(WORLD))
    simulation.step_batch(seed=1)
    yield simulation
    simulation.close()


def optics(**values: Any) -> ModuleMetadata:
    return ModuleMetadata(sensor={"cameras": {"camera": values}})


@pytest.mark.parametrize("value", [*EDGES, *(-edge for edge in EDGES), 0.639, 64_001.0])
@pytest.mark.parametrize("key", ["fx_px", "fy_px"])
def test_focal_lengths_out_of_bounds_are_refused(
    simulation: Simulation, key: str, value: float
) -> None:
    with pytest.raises(InvalidInputError, match=r"0\.64 to 64000") as refused:
        simulation.step_sample(optics(**{key: value}))
    assert refused.value.field == f"metadata.sensor.cameras.camera.{key}"
    assert refused.value.received == value


@pytest.mark.parametrize("value", [LARGEST, 1e300, 1e30, 6401.0, -6401.0, -1e30, -LARGEST])
@pytest.mark.parametrize("key", ["cx_px", "cy_px"])
def test_centres_out_of_bounds_are_refused(simulation: Simulation, key: str, value: float) -> None:
    with pytest.raises(InvalidInputError, match="-6400 to 6400") as refused:
        simulation.step_sample(optics(**{key: value}))
    assert refused.value.field == f"metadata.sensor.cameras.camera.{key}"


@pytest.mark.parametrize("values", [{"fx_px": SMALLEST}, {"fy_px": 1e9}, {"cx_px": 1e308}])
def test_a_configuration_has_the_same_bounds(values: dict[str, float]) -> None:
    camera = {**WORLD["sensors"]["cameras"][0], **values}
    with pytest.raises(ConfigError, match=next(iter(values))):
        config_from_mapping({**WORLD, "sensors": {"cameras": [camera]}})


@pytest.mark.parametrize("focal", [0, 1])
@pytest.mark.parametrize("centre", [0, 1])
def test_cameras_at_the_bounds_are_rendered_in_time(
    simulation: Simulation, focal: int, centre: int
) -> None:
    bounds_px = optics_bounds_px(WIDTH_PX)
    ends = {key: bounds_px[key][focal if key[0] == "f" else centre] for key in bounds_px}
    begin_s = time.monotonic()
    sample = simulation.step_sample(optics(**ends))
    assert time.monotonic() - begin_s < IN_TIME_S
    assert not np.isnan(sample.frame("camera", "depth").data).any()


def test_a_long_lens_sees_the_stage_from_afar(simulation: Simulation) -> None:
    height_m = 0.9 * MAX_EXTENTS * EXTENT_M
    pose = pose_looking_down(0, 0, height_m)
    lens = {"fx_px": 1000.0 * WIDTH_PX, "fy_px": 1000.0 * WIDTH_PX, "cx_px": None, "cy_px": None}
    sample = simulation.step_sample(
        ModuleMetadata(sensor={"pose": pose, "cameras": {"camera": lens}})
    )
    depth_m = sample.frame("camera", "depth").data
    assert depth_m == pytest.approx(height_m, abs=EXTENT_M)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(
    ("value", "bound"),
    [
        (LARGEST, "-1e+07 to 1e+07"),
        (-LARGEST, "-1e+07 to 1e+07"),
        (1e155, "-1e+07 to 1e+07"),
        (-1e15, "-1e+07 to 1e+07"),
        (1e7, "at most 24000 m from the stage's centre"),
        (1e6, "at most 24000 m from the stage's centre"),
    ],
)
def test_poses_beyond_all_lenses_are_refused(
    simulation: Simulation, axis: int, value: float, bound: str
) -> None:
    position_m = [0.0, 0.0, 5.0]
    position_m[axis] = value
    pose = Pose((position_m[0], position_m[1], position_m[2]), (0.0, 0.0, 0.0, 1.0))
    with pytest.raises(InvalidInputError, match=re.escape(bound)):
        simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))


@pytest.mark.parametrize(
    "asset",
    [
        {"objects": {"1": {"scale": 1e300}}},
        {"objects": {"1": {"scale": SMALLEST}}},
        {"objects": {"1": {"position_m": [1e300, 0, 0]}}},
        {"objects": {"1": {"position_m": [0, 1e6, 0]}}},
        {
            "add": {
                "t": {"shape": "rock", "position_m": [0, 0, 1e6], "semantic_id": 90, "label": "t"}
            }
        },
        {
            "add": {
                "t": {
                    "shape": "rock",
                    "position_m": [0, 0, 0],
                    "scale": 1e30,
                    "semantic_id": 90,
                    "label": "t",
                }
            }
        },
    ],
)
def test_things_beyond_the_stage_s_reach_are_refused(
    simulation: Simulation, asset: dict[str, Any]
) -> None:
    with pytest.raises(InvalidInputError, match="expected"):
        simulation.step_sample(ModuleMetadata(asset=asset))


class Countdown:
    """Raises when asked for the n-th time."""

    def __init__(self, count: int) -> None:
        self.left = count

    def __call__(self) -> None:
        self.left -= 1
        if self.left <= 0:
            raise CancelledError("nobody waits")


def test_a_view_stops_inside_the_ray_caster(simulation: Simulation) -> None:
    wide = optics(fx_px=2.0, fy_px=2.0, cx_px=None, cy_px=None)
    before = simulation.info().sample_id
    for count in (1, 2):
        check = Countdown(count)
        with interruptible(check), pytest.raises(CancelledError):
            simulation.step_sample(wide)
        assert check.left == 0
    assert simulation.info().sample_id == before
    stop_if_unwanted()
    assert simulation.step_sample(wide).sample_id == before + 1


def test_every_band_of_a_large_image_asks_whether_somebody_waits() -> None:
    count = len(list(bands(480, 640)))
    assert count * BAND_PIXELS >= 480 * 640
    with interruptible(Countdown(count)), pytest.raises(CancelledError):
        list(bands(480, 640))


def test_every_camera_a_user_may_have_is_within_bounds() -> None:
    for width_px, fx_px in ((640, 541.0), (16384, 3e6), (4, 2.0), (1, 0.5)):
        camera = CameraConfig(width_px=width_px, height_px=4, fx_px=fx_px, fy_px=fx_px)
        assert camera.intrinsics.fx_px == fx_px
