"""Things that move, change and are added look the same to Blender as to rays cast at them."""

from typing import Any

import numpy as np
import pytest
from blender_process import in_blender

from oaisys_core import geometry
from oaisys_core.config import config_from_mapping
from oaisys_core.procedural.scatter.ids import id_of_added
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata

LABEL = {"label": "thing", "semantic_id": 30}
ROVER = {
    "name": "rover",
    "shape": "rover",
    "trajectory": {"waypoints_m": [[-4, -2], [4, 2]], "step_m": 2.0},
} | LABEL
CONFIG: dict[str, Any] = {
    "stage": {"surroundings": "plain", "preset": "mounds", "extent_m": 30.0, "resolution_px": 65},
    "materials": {"texture_size_px": 16},
    "assets": {
        "rocks": [{"count": [20, 20], "variants": 1}],
        "groups": [
            {"name": "moss", "shape": "moss_cushion", "count": [60, 60], "size_m": [0.4, 0.9]}
            | LABEL
        ],
        "objects": [
            {"name": "lander", "shape": "lander", "position_m": [3, -4, 0], "on_ground": True}
            | LABEL
        ],
        "movers": [ROVER],
    },
    "sensors": {
        "cameras": [
            {"width_px": 64, "height_px": 48, "fx_px": 45, "fy_px": 45}
            | {"modalities": ["depth", "semantic_0", "instance"]}
        ],
        "pose_policy": "allow",
    },
}
POSE = geometry.pose_looking_down(0.0, 0.0, 14.0)


def step(**asset: Any) -> ModuleMetadata:
    return ModuleMetadata(sensor={"pose": POSE}, asset=asset or None)


def test_blender_sees_each_change_as_rays_do() -> None:
    slab = {"shape": "boulder", "position_m": [-3, 3, 1], "scale": 2.0} | LABEL
    steps = [
        step(),
        step(objects={"60001": {"position_m": [-3, -4, 1], "scale": 0.6}}),
        step(add={"slab": slab}, groups={"moss": {"hidden": True}}),
        step(add={"slab": None}, groups={"moss": {"hidden": False, "scale": 1.5}}),
    ]
    cast = Simulation(config_from_mapping(CONFIG | {"backend": "analytic"}))
    cast.step_batch()
    rendered = in_blender("assets.samples", CONFIG, steps)
    rover_at = []
    for number, (metadata, sample) in enumerate(zip(steps, rendered, strict=True)):
        expected = cast.step_sample(metadata)
        for modality in ("instance", "semantic_0"):
            seen = sample.frame("camera", modality).data
            assert (seen == expected.frame("camera", modality).data).mean() > 0.995
        ids = sample.frame("camera", "instance").data
        assert (id_of_added("slab") in ids) == (number == 2)
        rover_at.append(np.argwhere(ids == 62_501).mean(axis=0))
    steps_px = np.linalg.norm(np.diff(rover_at, axis=0), axis=1)
    assert np.allclose(steps_px, 45 * 2.0 / 13.5, rtol=0.25), "two metres a sample, seen from 14 m"


@pytest.mark.long
def test_a_rover_leaves_tracks_behind_it_only() -> None:
    mover = ROVER | {
        "trajectory": {"waypoints_m": [[-6, 0], [6, 0]], "start_m": 5.0, "step_m": 1.0},
    }
    camera = {"width_px": 64, "height_px": 48, "fx_px": 45, "fy_px": 45, "modalities": ["albedo"]}
    config = CONFIG | {
        "stage": {"preset": "plane", "extent_m": 30.0, "resolution_px": 65},
        "assets": {"rocks": [], "movers": [mover]},
        "sensors": {"cameras": [camera], "pose_policy": "allow"},
    }
    samples = in_blender("assets.samples", config, [step() for _ in range(4)])
    light = [sample.frame("camera", "albedo").data.mean(axis=-1) for sample in samples]

    def share(number: int, first: int, end: int) -> float:
        """How bright it is where wheels pass, relative to beside, in rows of a picture."""
        rows = light[number][first:end]
        # Wheels are 0.72 m from the middle, 2.3 pixels from 14 m; the rover drives upwards.
        return float(rows[:, [29, 34]].mean() / rows[:, [27, 28, 31, 32, 35, 36]].mean())

    assert share(3, 25, 40) < 0.88
    assert share(3, 2, 8) > 0.95
    assert share(0, 28, 40) < 0.88
    assert share(0, 10, 17) > 0.95


def test_plants_show_the_colours_of_their_vertices() -> None:
    """A cushion of moss over bare ground is greener than what is around it."""
    moss = {"shape": "moss_cushion", "position_m": [0, 0, 1.5], "scale": 9.0} | LABEL
    cameras = [{"width_px": 64, "height_px": 48, "fx_px": 45, "fy_px": 45, "modalities": ["rgb"]}]
    config = CONFIG | {
        "assets": {"rocks": []},
        "sensors": {"cameras": cameras, "pose_policy": "allow"},
        "render": {"quality": "preview"},
    }
    image, _ = in_blender("assets.colors_of_added", config, step(add={"moss": moss}))
    red, green, blue = image[16:32, 24:40].reshape(-1, 3).mean(axis=0)
    assert green > red > blue
    red, green, _ = image[:4].reshape(-1, 3).mean(axis=0)
    assert red > green
