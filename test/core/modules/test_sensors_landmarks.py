"""Known landmarks are where K, distortion, mount and pose put them, in both backends."""

from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from hypothesis import given, settings
from hypothesis import strategies as st
from landmarks import (
    Lab,
    board,
    centres_px,
    displacement_px,
    lab,
    spheres,
    with_spheres,
    wrong_outline,
)
from scipy.spatial.transform import Rotation
from synthetic_worlds import SUNNY
from synthetic_worlds import settings as render_settings

from oaisys_core.backend.analytic import AnalyticBackend
from oaisys_core.config import CameraConfig
from oaisys_core.geometry import is_invertible
from oaisys_core.types import FloatArray, Frame

MOST_ERROR_PX = 0.05

LENSES: list[dict[str, float] | None] = [
    None,
    {"k1": -0.12, "k2": 0.02, "p1": 1e-3, "p2": -2e-3, "k3": 0.001},
    {"k1": 0.08, "k2": 0.01, "p1": -1e-3, "p2": 1e-3},
]


def ignore(progress: object) -> None:
    """Do nothing with it."""


def camera_config(
    size_px: tuple[int, int],
    focal: float,
    aspect: float,
    centre: tuple[float, float],
    lens: dict[str, float] | None,
    modalities: tuple[str, ...] = ("depth", "instance"),
) -> CameraConfig:
    """A camera; focal length and principal point as shares of the image's width and size."""
    w, h = size_px
    return CameraConfig.model_validate(
        {
            "width_px": w,
            "height_px": h,
            "fx_px": focal * w,
            "fy_px": focal * w * aspect,
            "cx_px": centre[0] * w,
            "cy_px": centre[1] * h,
            "distortion": lens,
            "modalities": modalities,
        }
    )


cameras = st.builds(
    camera_config,
    size_px=st.tuples(st.integers(40, 120), st.integers(40, 120)),
    focal=st.floats(0.9, 2.5),
    aspect=st.floats(0.6, 1.6),
    centre=st.tuples(st.floats(0.2, 0.8), st.floats(0.2, 0.8)),
    lens=st.sampled_from([None]),
)
bent_cameras = st.builds(
    camera_config,
    size_px=st.tuples(st.integers(40, 120), st.integers(40, 120)),
    focal=st.floats(1.1, 2.5),
    aspect=st.floats(0.8, 1.25),
    centre=st.tuples(st.floats(0.35, 0.65), st.floats(0.35, 0.65)),
    lens=st.sampled_from(LENSES[1:]),
)


def check(seen_by: Lab, balls: Any, frames: tuple[Frame, ...]) -> None:
    """The spheres' centres, and their outlines, are where OpenCV has them."""
    by_modality = {frame.modality: frame for frame in frames}
    seen, true = centres_px(seen_by, balls, by_modality)
    assert np.abs(seen - true).max() < MOST_ERROR_PX / 10
    is_ball = by_modality["instance"].data > 0
    assert wrong_outline(seen_by, balls, is_ball, MOST_ERROR_PX) == 0
    assert is_ball.sum() > 40


@settings(max_examples=25, deadline=None)
@given(config=st.one_of(cameras, bent_cameras), seed=st.integers(0, 2**32 - 1))
def test_landmarks_reproject_in_depth_and_labels(config: CameraConfig, seed: int) -> None:
    rng = np.random.default_rng(seed)
    seen_by = lab(config, rng)
    balls = spheres(seen_by, rng)
    backend = AnalyticBackend()
    backend.build(with_spheres(seen_by, balls), ignore)
    check(seen_by, balls, backend.render_all([seen_by.camera()], render_settings(), ignore))


def random_config(
    rng: np.random.Generator, index: int, modalities: tuple[str, ...]
) -> CameraConfig:
    lens = LENSES[index % 3]
    size_px = (int(rng.integers(60, 110)), int(rng.integers(60, 110)))
    centre = (float(rng.uniform(0.35, 0.65)), float(rng.uniform(0.35, 0.65)))
    focal, aspect = float(rng.uniform(1.2, 2.0)), float(rng.uniform(0.7, 1.4))
    config = camera_config(size_px, focal, aspect, centre, lens, modalities)
    assert is_invertible(config.intrinsics)
    return config


def test_landmarks_reproject_in_depth_and_labels_of_blender() -> None:
    rng = np.random.default_rng(11)
    labs = [lab(random_config(rng, index, ("depth", "instance")), rng) for index in range(6)]
    balls = [spheres(each, rng) for each in labs]
    cases = [(with_spheres(*pair), pair[0].camera()) for pair in zip(labs, balls, strict=True)]
    seen = in_blender("sensors.views", cases)
    for each, its_balls, frames in zip(labs, balls, seen, strict=True):
        check(each, its_balls, frames)


def sunward(rng: np.random.Generator) -> FloatArray:
    """(3, 3) optical axes of a camera that looks about the way the sunlight goes, rolled freely."""
    turn = Rotation.from_euler("zyx", (SUNNY.sun_azimuth_rad, -SUNNY.sun_elevation_rad, 0))
    astray = Rotation.from_rotvec(rng.uniform(-0.3, 0.3, 3))
    looking = (turn * astray).apply((-1.0, 0.0, 0.0))
    across = np.cross(looking, rng.normal(size=3))
    across /= np.linalg.norm(across)
    return np.column_stack((across, np.cross(looking, across), looking))


@pytest.mark.long
@pytest.mark.parametrize("is_bent", [False, True], ids=["straight", "bent"])
def test_landmarks_reproject_in_colour(is_bent: bool) -> None:
    rng = np.random.default_rng(12)
    labs = [
        lab(random_config(rng, 1 + index % 2 if is_bent else 0, ("rgb",)), rng, sunward(rng))
        for index in range(4)
    ]
    boards = [board(each, rng) for each in labs]
    cases = [(each.scene(), by.camera()) for each, by in zip(boards, labs, strict=True)]
    seen = in_blender("sensors.views", cases, 64)
    for (frame,), each, by in zip(seen, boards, labs, strict=True):
        assert np.linalg.norm(displacement_px(frame.data, *each.seen_by(by))) < MOST_ERROR_PX
