"""Settings of rendering, by configuration and metadata, and samples that fail."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from scipy.ndimage import binary_dilation, binary_erosion, sobel
from synthetic_worlds import BOX, CENTRED, SMALL_MATERIALS, SPHERE, camera, flat_world, settings

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import CancelledError, ConfigError, InvalidInputError
from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.scene import Lens
from oaisys_core.simulation import Simulation
from oaisys_core.types import (
    INSTANCE,
    RGB,
    ModuleMetadata,
    PinholeIntrinsics,
    Pose,
    Progress,
)

SMALL: dict[str, Any] = {
    "seed": 3,
    "backend": "analytic",
    "stage": {"preset": "plane", "extent_m": 40.0, "resolution_px": 3},
    "materials": SMALL_MATERIALS,
    "assets": {"rocks": []},
    "sensors": {
        "cameras": [{"width_px": 16, "height_px": 12, "modalities": ["rgb", "depth", "normal"]}]
    },
}


class Recorder(AnalyticBackend):
    """Keeps the settings that it renders with."""

    def render(self, cameras: Any, settings: Any, *callbacks: Any) -> Any:
        self.settings = settings
        return super().render(cameras, settings, *callbacks)


def simulation(**render: Any) -> tuple[Simulation, Recorder]:
    backend = Recorder()
    result = Simulation(config_from_mapping(SMALL | {"render": render}), backend)
    result.step_batch()
    return result, backend


def of_sample(sim: Simulation, **render: Any) -> set[str]:
    sample = sim.step_sample(ModuleMetadata(render=render))
    return {frame.modality for frame in sample.frames}


def test_presets_may_be_overridden_field_by_field() -> None:
    sim, backend = simulation(quality="high", samples=7, max_bounces=1, denoise=False)
    of_sample(sim)
    wanted = backend.settings
    assert (wanted.samples, wanted.max_bounces, wanted.denoise) == (7, 1, False)
    of_sample(sim, samples=None, max_bounces=None)
    assert (backend.settings.samples, backend.settings.max_bounces) == (8, 3)


@pytest.mark.parametrize(
    ("render", "bounds"),
    [
        ({}, (3, 6)),
        ({"samples": 5}, (5, 5)),
        ({"samples": 2, "max_samples": 4}, (2, 4)),
        ({"max_samples": 9}, (3, 9)),
        ({"max_samples": 2}, (2, 2)),
        ({"quality": "preview"}, (1, 1)),
        ({"quality": "preview", "max_samples": 2}, (1, 2)),
        ({"quality": "high"}, (8, 8)),
    ],
)
def test_samples_are_a_range(render: dict[str, Any], bounds: tuple[int, int]) -> None:
    sim, backend = simulation(**render)
    of_sample(sim)
    assert (backend.settings.samples, backend.settings.max_samples) == bounds


@pytest.mark.parametrize(
    ("render", "samples"),
    [
        ({"quality": "preview"}, 6),
        ({"quality": "preview", "samples": 1}, 0),
        ({"quality": "preview", "max_samples": 1}, 0),
        ({"quality": "standard"}, 6),
        ({"quality": "standard", "samples": 3}, 0),
        ({"quality": "high"}, 6),
        ({"quality": "final"}, 0),
    ],
)
def test_small_images_have_more_samples_unless_told(render: dict[str, Any], samples: int) -> None:
    sim, backend = simulation(**render)
    of_sample(sim)
    assert backend.settings.small_samples == samples


def test_quality_geometry_renders_no_colour() -> None:
    sim, _ = simulation()
    assert of_sample(sim, quality="geometry") == {"depth", "normal"}
    assert of_sample(sim) == {"depth", "normal"}
    assert of_sample(sim, quality="preview") == {"rgb", "depth", "normal"}


def test_passes_hold_until_they_are_changed() -> None:
    sim, _ = simulation(passes=["depth"])
    assert of_sample(sim) == {"depth"}
    assert of_sample(sim, passes=["rgb", "normal"]) == {"rgb", "normal"}
    assert of_sample(sim) == {"rgb", "normal"}
    assert of_sample(sim, passes=None) == {"rgb", "depth", "normal"}


@pytest.mark.parametrize(
    ("metadata", "path"),
    [
        ({"samples": 0}, "metadata.render.samples"),
        ({"samples": 4, "max_samples": 3}, "metadata.render.*max_samples: received 3, expected 4"),
        ({"passes": ["colour"]}, "metadata.render.passes"),
        ({"passes": ["depth", "flow"]}, "metadata.render.passes.1.*'flow', expected one of depth,"),
        ({"passes": ["disparity"]}, "metadata.render.passes.0: received 'disparity'"),
        ({"passes": []}, "metadata.render.passes"),
        ({"quality": "geometry", "passes": ["depth", "rgb"]}, "render.passes.1.*no colour"),
        ({"effects": {"bloom": {"radius_px": -1}}}, "metadata.render.effects.bloom.radius_px"),
        ({"view_transform": "film"}, "metadata.render.view_transform"),
        ({"time_budget_s": 0}, "metadata.render.time_budget_s"),
        ({"effects": {"grain": 1}}, "metadata.render.effects.grain"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_path(metadata: dict[str, Any], path: str) -> None:
    sim, _ = simulation()
    with pytest.raises(InvalidInputError, match=path):
        of_sample(sim, **metadata)
    with pytest.raises(ConfigError):
        simulation(**metadata)


def test_noise_depends_on_batch_and_sample_alone() -> None:
    noisy = {"effects": {"sensor_noise": {"full_well_e": 300.0}}}
    first, _ = simulation(**noisy)
    images = [first.step_sample().frame("camera", RGB).data for _ in range(2)]
    assert (images[0] != images[1]).any()
    other, _ = simulation(**noisy)
    state = first.state()
    state["batch"]["sample_id"] = 1
    other.restore(state)
    assert (other.step_sample().frame("camera", RGB).data == images[1]).all()


def test_a_cancelled_sample_leaves_everything_as_it_was() -> None:
    sim, _ = simulation()
    pose = Pose((1.0, 2.0, 8.0), (0.0, 2**-0.5, 0.0, 2**-0.5))
    before = sim.step_sample(ModuleMetadata(sensor={"pose": pose}))
    state = sim.state()

    def cancel(progress: Progress) -> None:
        raise CancelledError("enough")

    elsewhere = Pose((-3.0, 0.0, 5.0), pose.quat_xyzw)
    metadata = ModuleMetadata(
        sensor={"pose": elsewhere},
        environment={"sun_elevation_deg": -20.0},
        render={"exposure_ev": 3.0},
    )
    with pytest.raises(CancelledError):
        sim.step_sample(metadata, progress=cancel)
    assert sim.state() == state
    after = sim.step_sample()
    assert after.sample_id == 2
    assert after.rig_pose == before.rig_pose
    for one, other in zip(before.frames, after.frames, strict=True):
        assert (one.data == other.data).all()


BENT = PinholeIntrinsics(96, 72, 70.0, 70.0, 45.0, 38.0, (-0.3, 0.08, 0.004, -0.003, 0.0))
LOW = pose_looking_at((-6.0, -4.0, 5.25), (0.5, 0.0, 0.25))
ASIDE = pose_looking_at((-6.6, -3.2, 5.25), (-0.1, 0.8, 0.25))
BRIGHT = replace(
    flat_world(), primitives=tuple(replace(p, color_srgb=(1.0, 0.0, 0.0)) for p in (SPHERE, BOX))
)


def redness(image: Any) -> Any:
    rgb = image.astype(np.float64)
    return rgb[..., 0] - rgb[..., 2]


@pytest.fixture(scope="module")
def pictures() -> dict[str, Any]:
    """Colour through a lens, out of focus and in motion."""
    sharp = camera(LOW, CENTRED, (RGB,))
    moved = replace(sharp, T_map_previous=camera(ASIDE).T_map_camera)
    near = pose_looking_down(2.0, 1.0, 7.5)
    many = settings(32)
    cases = {
        "bent": (camera(LOW, BENT, (RGB,)), many),
        "sharp": (sharp, many),
        "moving": (replace(moved, shutter_share=1.0), many),
        "still": (replace(moved, shutter_share=0.0), many),
        "focused": (replace(camera(near, CENTRED, (RGB,)), lens=Lens(6.0, 0.05)), many),
        "unfocused": (replace(camera(near, CENTRED, (RGB,)), lens=Lens(2.0, 0.05)), many),
        "budget": (sharp, replace(settings(64), time_budget_s=1e-3)),
        "raw": (sharp, replace(many, view_transform="raw")),
        "standard": (sharp, replace(many, view_transform="standard")),
        "contrast": (sharp, replace(many, view_transform="agx_contrast")),
        "again": (sharp, many),
    }
    frames = in_blender("passes.pictures", BRIGHT, list(cases.values()))
    return {name: frame.data for name, frame in zip(cases, frames, strict=True)}


@pytest.mark.long
@pytest.mark.blender
def test_colour_through_a_lens_lies_where_the_labels_do(pictures: dict[str, Any]) -> None:
    backend = AnalyticBackend()
    backend.build(BRIGHT, lambda _: None)
    (labels,) = backend.render_all([camera(LOW, BENT, (INSTANCE,))], settings(), lambda _: None)
    own = labels.data > 0
    border = binary_dilation(own) & ~binary_erosion(own)
    red = redness(pictures["bent"]) > 0.5 * np.median(redness(pictures["bent"])[own & ~border])
    assert own.sum() > 300
    assert (red == own)[~border].mean() > 0.99
    for axis in range(2):
        centre = [np.nonzero(mask)[axis].mean() for mask in (red, own)]
        assert abs(centre[0] - centre[1]) < 0.3


def sharpness(image: Any) -> float:
    red = redness(image)
    return float(np.hypot(sobel(red, 0), sobel(red, 1)).max())


@pytest.mark.long
@pytest.mark.blender
def test_what_is_out_of_focus_is_blurred(pictures: dict[str, Any]) -> None:
    assert sharpness(pictures["unfocused"]) < 0.6 * sharpness(pictures["focused"])


@pytest.mark.blender
def test_motion_blurs_and_leaves_nothing_behind(pictures: dict[str, Any]) -> None:
    assert np.abs(pictures["moving"].astype(int) - pictures["sharp"]).max() > 30
    assert (pictures["still"] == pictures["sharp"]).all()
    assert (pictures["again"] == pictures["sharp"]).all()


@pytest.mark.blender
def test_standard_is_the_srgb_encoding_of_raw(pictures: dict[str, Any]) -> None:
    raw = pictures["raw"] / 255
    encoded = np.where(raw <= 0.0031308, 12.92 * raw, 1.055 * raw ** (1 / 2.4) - 0.055)
    bright = pictures["raw"] > 20
    assert np.abs(encoded * 255 - pictures["standard"])[bright].max() < 4


@pytest.mark.blender
def test_the_default_has_more_contrast_than_agx_about_the_same_grey(
    pictures: dict[str, Any],
) -> None:
    agx, contrast = (pictures[name].mean(axis=-1) for name in ("sharp", "contrast"))
    dark, bright = agx < np.quantile(agx, 0.2), agx > np.quantile(agx, 0.9)
    assert contrast[dark].mean() < agx[dark].mean()
    assert contrast[bright].mean() > agx[bright].mean()
    assert contrast.std() > 1.05 * agx.std()


@pytest.mark.blender
def test_a_tight_budget_leaves_fewer_pixels_enlarged(pictures: dict[str, Any]) -> None:
    rough, sharp = pictures["budget"], pictures["sharp"]
    assert rough.shape == sharp.shape
    assert (
        np.abs(np.diff(rough.astype(int), axis=1)).max()
        < 0.8 * np.abs(np.diff(sharp.astype(int), axis=1)).max()
    )
    apart = np.abs(rough.astype(int) - sharp)
    assert np.median(apart) < 25
    # Nothing is shifted: each way that it is moved by two pixels, it fits worse.
    inner = sharp[2:-2, 2:-2].astype(int)
    for rows, columns in ((0, 2), (4, 2), (2, 0), (2, 4)):
        shifted = rough[rows : rows + inner.shape[0], columns : columns + inner.shape[1]]
        assert np.abs(shifted - inner).mean() > np.abs(rough[2:-2, 2:-2] - inner).mean()
