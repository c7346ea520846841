"""Frames and projections against closed forms and OpenCV."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from landmarks import straightened
from scipy.spatial.transform import Rotation

from oaisys_core import geometry
from oaisys_core.errors import InvalidInputError
from oaisys_core.types import PinholeIntrinsics, Pose

INTRINSICS = PinholeIntrinsics(640, 480, 541.14, 530.0, 300.25, 251.5)


def random_poses(count: int) -> list[Pose]:
    rng = np.random.default_rng(7)
    positions_m = rng.uniform(-50, 50, (count, 3))
    quats = Rotation.random(count, random_state=7).as_quat()
    return [geometry.check_pose(p, q) for p, q in zip(positions_m, quats, strict=True)]


@pytest.mark.parametrize("pose", random_poses(20))
def test_pose_matrix_round_trip(pose: Pose) -> None:
    back = geometry.pose_from_matrix(geometry.pose_to_matrix(pose))
    assert np.allclose(back.position_m, pose.position_m, atol=1e-12)
    assert abs(np.dot(back.quat_xyzw, pose.quat_xyzw)) == pytest.approx(1.0, abs=1e-12)


def test_a_pose_without_rotation_is_the_matrix_that_scipy_makes() -> None:
    pose = Pose((1.0, -2.0, 3.5), (0.0, 0.0, 0.0, 1.0))
    expected = geometry.transform(Rotation.from_quat(pose.quat_xyzw).as_matrix(), pose.position_m)
    assert geometry.pose_to_matrix(pose).tobytes() == expected.tobytes()


@pytest.mark.parametrize("pose", random_poses(5))
def test_inverse(pose: Pose) -> None:
    T = geometry.pose_to_matrix(pose)
    assert np.allclose(geometry.invert(T) @ T, np.eye(4), atol=1e-12)


def test_optical_axes_are_those_of_rep_103() -> None:
    link_from_optical = geometry.R_LINK_OPTICAL
    assert (link_from_optical @ (0, 0, 1) == (1, 0, 0)).all(), "optical z is the link's x"
    assert (link_from_optical @ (1, 0, 0) == (0, -1, 0)).all(), "optical x is the link's -y"
    assert (link_from_optical @ (0, 1, 0) == (0, 0, -1)).all(), "optical y is the link's -z"


@pytest.mark.parametrize("pose", random_poses(20))
def test_projection_agrees_with_opencv(pose: Pose) -> None:
    T_map_camera = geometry.pose_to_matrix(pose) @ geometry.T_LINK_OPTICAL
    rng = np.random.default_rng(3)
    points_camera_m = rng.uniform((-3, -3, 2), (3, 3, 12), (50, 3))
    points_map_m = points_camera_m @ T_map_camera[:3, :3].T + T_map_camera[:3, 3]
    T_camera_map = geometry.invert(T_map_camera)
    rvec, _ = cv2.Rodrigues(T_camera_map[:3, :3])
    expected, _ = cv2.projectPoints(
        points_map_m, rvec, T_camera_map[:3, 3], INTRINSICS.K, np.zeros(5)
    )
    assert np.allclose(geometry.project(points_camera_m, INTRINSICS), expected[:, 0], atol=1e-6)


def test_unproject_inverts_project() -> None:
    points_m = np.random.default_rng(5).uniform((-3, -3, 1), (3, 3, 9), (100, 3))
    pixels = geometry.project(points_m, INTRINSICS)
    assert np.allclose(geometry.unproject(pixels, points_m[:, 2], INTRINSICS), points_m)


def test_depth_to_points_agrees_with_pixel_rays() -> None:
    depth_m = np.random.default_rng(1).uniform(1, 20, (480, 640)).astype(np.float32)
    depth_m[0, 0] = np.inf
    points_m = geometry.depth_to_points(depth_m, INTRINSICS)
    expected_m = geometry.pixel_rays(INTRINSICS) * depth_m[..., None]
    assert not np.isfinite(points_m[0, 0]).all()
    finite = np.isfinite(depth_m)
    assert np.allclose(points_m[finite], expected_m[finite], rtol=1e-6, atol=1e-6)


def test_looking_down_has_the_upper_edge_along_x() -> None:
    T = geometry.pose_to_matrix(geometry.pose_looking_down(1, 2, 30)) @ geometry.T_LINK_OPTICAL
    assert np.allclose(T[:3, 2], (0, 0, -1)), "the camera looks down"
    assert np.allclose(T[:3, 1], (-1, 0, 0)), "the image's lower edge is towards -x"


@pytest.mark.parametrize("far_m", [1.1e7, 1e155, 1.7e308, np.inf, np.nan])
def test_positions_whose_squares_overflow_are_refused(far_m: float) -> None:
    """Norms are infinite from 1e154: a rotation had no determinant."""
    for target_m, eye_m in (((far_m, 0, 0), (0, 0, 5)), ((0, 0, 0), (0, -far_m, 5))):
        with pytest.raises(InvalidInputError, match=r"(eye|target)_m: .*-1e\+07 to 1e\+07"):
            geometry.pose_looking_at(eye_m, target_m)
    with pytest.raises(InvalidInputError, match=r"pose\.position: received \["):
        geometry.check_pose((0, far_m, 0), (0, 0, 0, 1))
    assert geometry.check_pose((0, 1e7, 0), (0, 0, 0, 1)).position_m == (0, 1e7, 0)
    wrong: list[Any] = ["x", (1, "y", 2), ((1, 2), 3, 4), None]
    for none in wrong:
        with pytest.raises(InvalidInputError, match=r"pose\.position"):
            geometry.check_pose(none, (0, 0, 0, 1))
        with pytest.raises(InvalidInputError, match=r"pose\.orientation"):
            geometry.check_pose((0, 0, 0), none)


def test_what_an_array_masks_is_no_number() -> None:
    here, level = np.zeros(3), np.array((0.0, 0, 0, 1))
    with pytest.raises(InvalidInputError, match=r"pose\.position"):
        geometry.check_pose(np.ma.array(here, mask=[0, 1, 0]), level)
    with pytest.raises(InvalidInputError, match=r"pose\.orientation"):
        geometry.check_pose(here, np.ma.array(level, mask=True))
    geometry.check_pose(np.ma.array(here), np.ma.array(level, mask=False))


def test_looking_at_points_at_the_target_without_roll() -> None:
    pose = geometry.pose_looking_at((1, 2, 3), (4, -2, 1))
    R = geometry.pose_to_matrix(pose)[:3, :3]
    direction = np.array((3, -4, -2)) / np.sqrt(29)
    assert np.allclose(R[:, 0], direction)
    assert R[2, 1] == pytest.approx(0), "the body's y stays level"
    with pytest.raises(InvalidInputError):
        geometry.pose_looking_at((0, 0, 5), (0, 0, 1))


@pytest.mark.parametrize(
    ("position_m", "quat_xyzw", "field"),
    [
        ((np.nan, 0, 0), (0, 0, 0, 1), "pose.position"),
        ((0, np.inf, 0), (0, 0, 0, 1), "pose.position"),
        ((0, 0), (0, 0, 0, 1), "pose.position"),
        ((0, 0, 0), (0, 0, 0, 0), "pose.orientation"),
        ((0, 0, 0), (0, 0.39, 0, 0.94), "pose.orientation"),
        ((0, 0, 0), (0, np.nan, 0, 1), "pose.orientation"),
    ],
)
def test_bad_poses_are_refused_by_field(position_m, quat_xyzw, field) -> None:
    with pytest.raises(InvalidInputError) as caught:
        geometry.check_pose(position_m, quat_xyzw)
    assert caught.value.field == field


@pytest.mark.parametrize("quat_xyzw", [(0, 0.38, 0, 0.93), (0, 0, 0, 1.009), (0.991, 0, 0, 0)])
def test_a_quaternion_within_one_percent_is_normalised(quat_xyzw) -> None:
    pose = geometry.check_pose((0, 0, 0), quat_xyzw)
    assert pose.quat_xyzw == pytest.approx(quat_xyzw / np.linalg.norm(quat_xyzw), abs=1e-15)


def test_a_checked_pose_and_a_pose_of_a_motion_stay_as_they_are_when_checked_again() -> None:
    """A record's pose is checked when it is repeated."""
    rng = np.random.default_rng(3)
    drawn = Rotation.random(3000, random_state=3)
    turned = drawn * Rotation.random(3000, random_state=4) * Rotation.random(3000, random_state=5)
    typed = drawn.as_quat() * (1 + rng.uniform(-9e-4, 9e-4, (3000, 1)))
    poses = [geometry.check_pose((0, 0, 0), quat) for quat in (*typed, *typed.astype(np.float32))]
    poses += [Pose((0.0, 0.0, 0.0), tuple(quat)) for quat in turned.as_quat().tolist()]
    for pose in poses:
        assert abs(np.linalg.norm(pose.quat_xyzw) - 1) < 1e-14
        assert geometry.check_pose(pose.position_m, pose.quat_xyzw) == pose


LENSES = {
    "barrel": (-0.28, 0.07, 1e-3, -2e-3, 0.01),
    "cushion": (0.12, 0.03, -2e-3, 1e-3, 0.0),
    "tangential": (0.0, 0.0, 5e-3, -4e-3, 0.0),
}


@pytest.mark.parametrize("distortion", LENSES.values(), ids=LENSES)
def test_rays_of_bent_pixels_lead_back_to_them_in_opencv(distortion: tuple[float, ...]) -> None:
    camera = PinholeIntrinsics(120, 90, 88.0, 94.0, 61.3, 40.2, distortion)
    rays = geometry.pixel_rays(camera)
    v, u = np.mgrid[:90, :120]
    pixels = np.stack((u, v), axis=-1).reshape(-1, 2)

    there, _ = cv2.projectPoints(
        rays.reshape(-1, 3), np.zeros(3), np.zeros(3), camera.K, np.array(distortion)
    )
    assert np.abs(there[:, 0] - pixels).max() < 1e-9 * 88
    assert np.allclose(geometry.project(rays.reshape(-1, 3), camera), there[:, 0], atol=1e-10)
    back = straightened(pixels, camera.K, np.array(distortion))
    assert np.abs(back - rays[..., :2].reshape(-1, 2)).max() < 1e-9


def test_a_bent_depth_image_gives_points_on_its_rays() -> None:
    camera = PinholeIntrinsics(40, 30, 30.0, 31.0, 19.0, 15.0, LENSES["barrel"])
    depth_m = np.random.default_rng(1).uniform(1, 9, (30, 40)).astype(np.float32)
    depth_m[3, 4] = np.inf
    points_m = geometry.depth_to_points(depth_m, camera)
    pixels = np.array([(0, 0), (39, 29), (20, 11)])
    there_m = geometry.unproject(pixels, depth_m[pixels[:, 1], pixels[:, 0]], camera)
    assert np.allclose(points_m[pixels[:, 1], pixels[:, 0]], there_m, rtol=1e-6)
    assert np.allclose(geometry.project(there_m, camera), pixels, atol=1e-9)
    assert not np.isfinite(points_m[3, 4]).any()


@settings(max_examples=60, deadline=None)
@given(
    k=st.tuples(*[st.floats(-0.4, 0.4)] * 3),
    p=st.tuples(*[st.floats(-0.02, 0.02)] * 2),
    focal_px=st.floats(40, 120),
)
def test_a_lens_is_either_refused_or_has_an_exact_inverse(
    k: tuple[float, float, float], p: tuple[float, float], focal_px: float
) -> None:
    camera = PinholeIntrinsics(64, 48, focal_px, focal_px, 31.5, 23.5, (*k[:2], *p, k[2]))
    rays = geometry.pixel_rays(camera)
    if not geometry.is_invertible(camera):
        return
    there, _ = cv2.projectPoints(
        rays.reshape(-1, 3), np.zeros(3), np.zeros(3), camera.K, np.array(camera.distortion)
    )
    v, u = np.mgrid[:48, :64]
    assert np.abs(there[:, 0] - np.stack((u, v), axis=-1).reshape(-1, 2)).max() < 1e-9 * focal_px
    # Neighbouring pixels see neighbouring directions, in the same order: nothing is folded over.
    assert (np.diff(rays[..., 0], axis=1) > 0).all()
    assert (np.diff(rays[..., 1], axis=0) > 0).all()


def test_a_lens_whose_image_folds_is_known() -> None:
    # r (1 - r**2 / 2) has its greatest value, 0.544, at r = 0.816: beyond it the image turns back.
    focal_px = 50.5 / 0.5443
    bent = (-0.5, 0.0, 0.0, 0.0, 0.0)
    inside = PinholeIntrinsics(101, 1, 1.02 * focal_px, 100.0, 50.0, 0.0, bent)
    outside = replace(inside, fx_px=0.98 * focal_px)
    assert geometry.is_invertible(inside)
    assert not geometry.is_invertible(outside)


COEFFICIENT = st.floats(-0.4, 0.4)
DIRECTIONS = Rotation.random(4000, random_state=3).apply((0.0, 0.0, 1.0))


@settings(max_examples=60, deadline=None)
@given(
    lens=st.one_of(
        st.tuples(*[COEFFICIENT] * 2, *[st.floats(-0.02, 0.02)] * 2, COEFFICIENT),
        st.tuples(*[st.floats(-0.1, 0.1)] * 4),
    ),
    focal_px=st.floats(30, 120),
)
@example((0.0, 0.0, 0.0, 0.0, -0.25), 52.0)  # directions just on this side of its fold
def test_where_a_lens_is_not_known_nothing_is_projected(
    lens: tuple[float, ...], focal_px: float
) -> None:
    """Polynomials were applied everywhere: values up to 1e38, and folded ones inside the image."""
    model = "equidistant" if len(lens) == 4 else "plumb_bob"
    camera = PinholeIntrinsics(64, 48, focal_px, focal_px, 31.5, 23.5, lens, model)
    if camera.is_rectilinear or not geometry.is_invertible(camera):
        return
    v, u = np.mgrid[:48, :64]
    seen = geometry.project(geometry.pixel_rays(camera).reshape(-1, 3), camera)
    assert np.abs(seen - np.stack((u, v), axis=-1).reshape(-1, 2)).max() < 1e-8 * focal_px
    pixels = geometry.project(DIRECTIONS, camera)
    known = np.isfinite(pixels).all(axis=1)
    assert (known == ~np.isnan(pixels).any(axis=1)).all(), "NaN, never inf"
    back = geometry.unproject(pixels[known], np.ones(known.sum()), camera)
    back /= np.linalg.norm(back, axis=1)[:, None]
    assert np.abs(back - DIRECTIONS[known]).max(initial=0) < 1e-6
    assert np.isnan(geometry.project(np.array([(0.0, 0.0, -1.0)]), camera)).all()


def test_distances_along_a_line_add_up() -> None:
    line_m = [[0, 0, 0], [3, 4, 0], [3, 4, 12], [3, 4, 12]]
    assert geometry.distances_along_m(line_m).tolist() == [0, 5, 17, 17]
