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
    fisheye_rays,
    lab,
    spheres,
    with_spheres,
    wrong_outline,
)
from scipy.spatial.transform import Rotation
from synthetic_worlds import SUNNY
from synthetic_worlds import settings as render_settings

from oaisys_core.config import CameraConfig
from oaisys_core.geometry import is_invertible
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.types import FloatArray, Frame

MAX_ERROR_PX = 0.05

LENSES: list[dict[str, float] | None] = [
    None,
    {"k1": -0.12, "k2": 0.02, "p1": 1e-3, "p2": -2e-3, "k3": 0.001},
    {"k1": 0.08, "k2": 0.01, "p1": -1e-3, "p2": 1e-3},
]

FISHEYES: list[dict[str, float]] = [
    {},
    {"k1": -0.02, "k2": 0.006, "k3": -0.002, "k4": 0.0004},
    {"k1": 0.05, "k2": -0.02, "k3": 0.004, "k4": -0.0005},
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
    model: str = "distortion",
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
            model: lens,
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


fisheyes = st.builds(
    camera_config,
    size_px=st.tuples(st.integers(60, 120), st.integers(60, 120)),
    focal=st.floats(0.7, 1.2),
    aspect=st.floats(0.8, 1.25),
    centre=st.tuples(st.floats(0.35, 0.65), st.floats(0.35, 0.65)),
    lens=st.sampled_from(FISHEYES),
    model=st.just("fisheye"),
)


def check(seen_by: Lab, balls: Any, frames: tuple[Frame, ...]) -> None:
    """The spheres' centres, and their outlines, are where OpenCV has them."""
    by_modality = {frame.modality: frame for frame in frames}
    seen, true = centres_px(seen_by, balls, by_modality)
    assert np.abs(seen - true).max() < MAX_ERROR_PX / 10
    is_ball = by_modality["instance"].data > 0
    assert wrong_outline(seen_by, balls, is_ball, MAX_ERROR_PX) == 0
    assert is_ball.sum() > 40


@settings(max_examples=25, deadline=None)
@given(config=st.one_of(cameras, bent_cameras, fisheyes), seed=st.integers(0, 2**32 - 1))
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
    configs = [random_config(rng, index, ("depth", "instance")) for index in range(6)]
    configs += [wide_config(FISHEYES[1], 0.75, (0.45, 0.55), ("depth", "instance"))]
    labs = [lab(config, rng) for config in configs]
    balls = [spheres(each, rng) for each in labs]
    cases = [(with_spheres(*pair), pair[0].camera()) for pair in zip(labs, balls, strict=True)]
    seen = in_blender("sensors.views", cases)
    for each, its_balls, frames in zip(labs, balls, seen, strict=True):
        check(each, its_balls, frames)


def wide_config(
    lens: dict[str, float],
    focal: float,
    centre: tuple[float, float] | None,
    modalities: tuple[str, ...],
) -> CameraConfig:
    """A fisheye; its principal point is in the image's centre without another ``centre``."""
    w, h = 110, 96
    centre = centre or ((w - 1) / 2 / w, (h - 1) / 2 / h)
    return camera_config((w, h), focal, 1.1, centre, lens, modalities, "fisheye")


def sunward(rng: np.random.Generator) -> FloatArray:
    """(3, 3) optical axes of a camera that looks about the way the sunlight goes, rolled freely."""
    turn = Rotation.from_euler("zyx", (SUNNY.sun_azimuth_rad, -SUNNY.sun_elevation_rad, 0))
    astray = Rotation.from_rotvec(rng.uniform(-0.3, 0.3, 3))
    looking = (turn * astray).apply((-1.0, 0.0, 0.0))
    across = np.cross(looking, rng.normal(size=3))
    across /= np.linalg.norm(across)
    return np.column_stack((across, np.cross(looking, across), looking))


@pytest.mark.parametrize(
    "is_bent",
    [
        pytest.param(False, marks=pytest.mark.soak, id="straight"),
        pytest.param(True, marks=pytest.mark.long, id="bent"),
    ],
)
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
        assert np.linalg.norm(displacement_px(frame.data, *each.seen_by(by))) < MAX_ERROR_PX


def sunward_lab(config: CameraConfig, place: tuple[float, float], rng: np.random.Generator) -> Lab:
    """A fisheye that looks about the way the sunlight goes at a place in its image."""
    anyhow = lab(config, rng)
    pixel = np.array(((place[0] * config.width_px, place[1] * config.height_px),))
    ray = fisheye_rays(pixel, anyhow.K, anyhow.coefficients)
    turn, _ = Rotation.align_vectors(np.array(((0.0, 0.0, 1.0),)), ray)
    return lab(config, rng, sunward(rng) @ turn.as_matrix())


@pytest.mark.long
def test_landmarks_reproject_in_colour_of_fisheyes() -> None:
    rng = np.random.default_rng(13)
    wide = [
        # (lens, focal length in image widths, principal point, place and tiles of the board)
        (FISHEYES[0], 0.5, None, (0.5, 0.5), 60),
        (FISHEYES[1], 0.5, None, (0.3, 0.65), 60),
        (FISHEYES[2], 0.5, (0.46, 0.53), (0.65, 0.5), 60),
        # About 90 degrees off the axis, and small, because light varies over a near board.
        (FISHEYES[0], 0.22, None, (0.85, 0.5), 16),
        (FISHEYES[0], 0.22, (0.47, 0.53), (0.15, 0.5), 16),
    ]
    labs = [
        sunward_lab(wide_config(lens, focal, centre, ("rgb",)), place, rng)
        for lens, focal, centre, place, _ in wide
    ]
    boards = [
        board(by, rng, place, tile_px) for by, (*_, place, tile_px) in zip(labs, wide, strict=True)
    ]
    cases = [(each.scene(), by.camera()) for each, by in zip(boards, labs, strict=True)]
    seen = in_blender("sensors.views", cases, 64)
    for (frame,), each, by in zip(seen, boards, labs, strict=True):
        assert np.linalg.norm(displacement_px(frame.data, *each.seen_by(by))) < MAX_ERROR_PX
