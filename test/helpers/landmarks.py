"""Landmarks of known place, seen by cameras of any K, mount and pose.

Where they must appear is computed with OpenCV and scipy alone, from the numbers of the
configuration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from synthetic_worlds import SUNNY, flat_world

from oaisys_core.config import CameraConfig, SensorsConfig
from oaisys_core.scene import PlacedCamera, Primitive, Scene
from oaisys_core.types import FloatArray, Frame, Pose
from oaisys_core.world.module import World
from oaisys_core.world.modules import SensorsModule

AXES_OF_OPTICAL_IN_LINK = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""REP-103: the optical z axis is the link's x, x its -y, y its -z."""

TILE_M = 0.35
"""Edge of a bright or dark tile."""

TILE_PX = 60
"""How large a tile that faces the camera appears."""

BRIGHT, DARK = 0.85, 0.3
"""Colours of the tiles, in sRGB."""


def straightened(
    pixels: FloatArray,
    K: FloatArray,
    coefficients: FloatArray,
) -> FloatArray:
    """(N, 2) directions at z = 1 that (N, 2) pixels see, by OpenCV's iteration carried on."""
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 500, 1e-13)
    points = np.asarray(pixels, dtype=np.float64)[:, None]
    if hasattr(cv2, "undistortPointsIter"):  # OpenCV 4; it is undistortPoints in OpenCV 5
        found = cv2.undistortPointsIter(points, K, coefficients, None, None, criteria)
    else:
        found = cv2.undistortPoints(points, K, coefficients, criteria=criteria)
    return np.asarray(found[:, 0], dtype=np.float64)


def fisheye_rays(pixels: FloatArray, K: FloatArray, coefficients: FloatArray) -> FloatArray:
    """(N, 3) unit vectors that (N, 2) pixels of a fisheye see, also beyond 90 degrees.

    OpenCV's own inverse ends at 90 degrees; this one looks angles up in a table of OpenCV's model.
    """
    angles = np.linspace(0, np.pi, 200_001)
    radii = angles * np.polyval([*coefficients[::-1], 1.0], angles**2)
    radii = np.maximum.accumulate(radii)
    xy = (pixels - K[:2, 2]) / np.diag(K)[:2]
    radius = np.linalg.norm(xy, axis=1)
    angle = np.interp(radius, radii, angles)
    across = xy / np.maximum(radius, 1e-12)[:, None] * np.sin(angle)[:, None]
    return np.column_stack((across, np.cos(angle)))


@dataclass(frozen=True)
class Lab:
    """A camera on a rig somewhere, and its pose in ``map`` as scipy has it.

    Attributes:
        R_map_optical: (3, 3).
        eye_m: (3,) in ``map``.
    """

    config: CameraConfig
    rig: Pose
    R_map_optical: FloatArray
    eye_m: FloatArray

    @property
    def K(self) -> FloatArray:  # noqa: N802 - the field's name for the camera matrix
        """The camera matrix."""
        c = self.config
        assert c.cx_px is not None
        assert c.cy_px is not None
        return np.array([[c.fx_px, 0, c.cx_px], [0, c.fy_px, c.cy_px], [0, 0, 1.0]])

    @property
    def coefficients(self) -> FloatArray:
        """OpenCV's distortion coefficients."""
        fisheye, d = self.config.fisheye, self.config.distortion
        if fisheye is not None:
            return np.array((fisheye.k1, fisheye.k2, fisheye.k3, fisheye.k4))
        return np.zeros(5) if d is None else np.array((d.k1, d.k2, d.p1, d.p2, d.k3))

    def camera(self) -> PlacedCamera:
        """The camera as the simulator places it."""
        module = SensorsModule(SensorsConfig(cameras=(self.config,)))
        world = World()
        module.step_batch(world, {"pose": self.rig}, np.random.default_rng(0))
        return world.cameras[0]

    def pixel_of(self, points_map_m: FloatArray) -> FloatArray:
        """(N, 2) pixels of (N, 3) points, by OpenCV."""
        R = self.R_map_optical.T
        rvec, _ = cv2.Rodrigues(R)
        project = cv2.projectPoints if self.config.fisheye is None else cv2.fisheye.projectPoints
        pixels, _ = project(
            np.asarray(points_map_m, dtype=np.float64).reshape(-1, 1, 3),
            rvec, -R @ self.eye_m, self.K, self.coefficients,
        )  # fmt: skip
        return np.asarray(pixels[:, 0], dtype=np.float64)

    def rays(self, offset_px: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
        """(H, W, 3) directions of what OpenCV sees beside the pixels' centres.

        They have z = 1, those of a fisheye length 1.
        """
        h, w = self.config.height_px, self.config.width_px
        v, u = np.mgrid[:h, :w].astype(np.float64)
        pixels = np.stack((u + offset_px[0], v + offset_px[1]), axis=-1).reshape(-1, 2)
        if self.config.fisheye is not None:
            return fisheye_rays(pixels, self.K, self.coefficients).reshape(h, w, 3)
        flat = straightened(pixels, self.K, self.coefficients)
        return np.concatenate((flat.reshape(h, w, 2), np.ones((h, w, 1))), axis=-1)

    def in_map(self, points_optical_m: FloatArray) -> FloatArray:
        """(N, 3) points of the optical frame in ``map``."""
        return np.asarray(points_optical_m @ self.R_map_optical.T + self.eye_m)


def lab(
    config: CameraConfig, rng: np.random.Generator, R_map_optical: FloatArray | None = None
) -> Lab:
    """A camera mounted and turned at random, high above the ground.

    ``R_map_optical`` settles which way it looks, whatever its mount.
    """
    mount = Rotation.random(random_state=int(rng.integers(2**31)))
    at_m = rng.uniform(-0.5, 0.5, 3)
    mounted = config.model_copy(
        update={
            "mount_position_m": tuple(at_m.tolist()),
            "mount_quat_xyzw": tuple(mount.as_quat().tolist()),
        }
    )
    R_base_optical = mount.as_matrix() @ AXES_OF_OPTICAL_IN_LINK
    R_map_base = (
        Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
        if R_map_optical is None
        else R_map_optical @ R_base_optical.T
    )
    base_m = rng.uniform((-9, -9, 60), (9, 9, 80))
    x, y, z, w = Rotation.from_matrix(R_map_base).as_quat().tolist()
    px, py, pz = base_m.tolist()
    return Lab(
        config=mounted,
        rig=Pose((px, py, pz), (x, y, z, w)),
        R_map_optical=R_map_base @ R_base_optical,
        eye_m=base_m + R_map_base @ at_m,
    )


def spheres(seen_by: Lab, rng: np.random.Generator) -> list[tuple[FloatArray, float]]:
    """Centres in the optical frame and radii of four spheres, one in each quarter of the image."""
    h, w = seen_by.config.height_px, seen_by.config.width_px
    rays = seen_by.rays()
    radius_px = 0.1 * min(w, h)
    result = []
    for u_share, v_share in ((0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)):
        u, v = (np.array((u_share * w, v_share * h)) + rng.uniform(-2, 2, 2)).astype(int)
        depth_m = float(rng.uniform(3, 8))
        focal_px = max(seen_by.config.fx_px, seen_by.config.fy_px)
        result.append((rays[v, u] * depth_m, radius_px * depth_m / focal_px))
    return result


def with_spheres(seen_by: Lab, balls: list[tuple[FloatArray, float]]) -> Scene:
    """A world with spheres, of instance ids from 1."""
    primitives = []
    for index, (centre_m, radius_m) in enumerate(balls):
        T = np.eye(4)
        T[:3, 3] = seen_by.in_map(centre_m[None])[0]
        size_m = (radius_m, radius_m, radius_m)
        primitives.append(Primitive("sphere", size_m, T, index + 1, (20,), (0.6, 0.3, 0.2)))
    return replace(flat_world(), primitives=tuple(primitives))


def centres_px(
    seen_by: Lab, balls: list[tuple[FloatArray, float]], frames: dict[str, Frame]
) -> tuple[FloatArray, FloatArray]:
    """(N, 2) pixels where the depth image has the spheres' centres, and where OpenCV has them.

    All points p of a sphere fulfil 2 p c - (c c - r r) = p p, which is linear in its unknowns.
    """
    rays, depth_m = seen_by.rays(), frames["depth"].data.astype(np.float64)
    found = []
    for index in range(len(balls)):
        is_seen = frames["instance"].data == index + 1
        on_ball = rays[is_seen] * depth_m[is_seen, None]
        system = np.column_stack((2 * on_ball, -np.ones(len(on_ball))))
        solution, *_ = np.linalg.lstsq(system, (on_ball**2).sum(axis=1), rcond=None)
        found.append(solution[:3])
    seen = seen_by.pixel_of(seen_by.in_map(np.array(found)))
    true = seen_by.pixel_of(seen_by.in_map(np.array([centre_m for centre_m, _ in balls])))
    return seen, true


def wrong_outline(
    seen_by: Lab, balls: list[tuple[FloatArray, float]], is_ball: NDArray[np.bool_], by_px: float
) -> int:
    """How many pixels are on the wrong side of an outline, and farther from it than ``by_px``."""
    cases = [
        _hits(seen_by.rays(offset), balls)
        for offset in ((0, 0), (by_px, 0), (-by_px, 0), (0, by_px), (0, -by_px))
    ]
    surely = np.logical_and.reduce(cases)
    perhaps = np.logical_or.reduce(cases)
    return int((surely & ~is_ball).sum() + (is_ball & ~perhaps).sum())


def _hits(rays: FloatArray, balls: list[tuple[FloatArray, float]]) -> NDArray[np.bool_]:
    unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    hit = np.zeros(rays.shape[:2], dtype=bool)
    for centre_m, radius_m in balls:
        along_m = unit @ centre_m
        beside_m2 = centre_m @ centre_m - along_m**2
        hit |= (beside_m2 <= radius_m**2) & (along_m > 0)
    return hit


@dataclass(frozen=True)
class Board:
    """Two bright and two dark tiles in one plane, in ``map``.

    Attributes:
        R_map_board: (3, 3); the tiles' outer faces are at z = 0 of the board, which points away.
        corner_m: (3,) where all four meet.
    """

    R_map_board: FloatArray
    corner_m: FloatArray

    def scene(self) -> Scene:
        """A world with this board."""
        tiles = []
        for index, (i, j) in enumerate(((-1, -1), (1, -1), (-1, 1), (1, 1))):
            T = np.eye(4)
            T[:3, :3] = self.R_map_board
            beside_m = np.array((i * TILE_M / 2, j * TILE_M / 2, TILE_M / 8))
            T[:3, 3] = self.corner_m + self.R_map_board @ beside_m
            grey = BRIGHT if i == j else DARK
            size_m = (TILE_M, TILE_M, TILE_M / 4)
            tiles.append(Primitive("box", size_m, T, index + 1, (21,), (grey, grey, grey)))
        return replace(flat_world(), primitives=tuple(tiles), sky=SUNNY)

    def seen_by(self, camera: Lab) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """(H, W) brightness, averaged over each pixel, and (H, W) 1 where only tiles are seen."""
        offsets = (np.arange(8) + 0.5) / 8 - 0.5
        parts = [self._at(camera.rays((x, y)), camera) for x in offsets for y in offsets]
        brightness = np.mean(parts, axis=0)
        inside = (np.min(parts, axis=0) > 0).astype(np.uint8)
        return brightness.astype(np.float32), cv2.erode(inside, np.ones((5, 5), np.uint8))

    def _at(self, rays: FloatArray, camera: Lab) -> FloatArray:
        directions = rays @ camera.R_map_optical.T @ self.R_map_board
        from_corner_m = (camera.eye_m - self.corner_m) @ self.R_map_board
        reach = -from_corner_m[2] / directions[..., 2]
        x, y = np.moveaxis(from_corner_m + reach[..., None] * directions, -1, 0)[:2]
        on_board = (np.abs(x) < TILE_M) & (np.abs(y) < TILE_M) & (reach > 0)
        return np.where(on_board, np.where(x * y > 0, BRIGHT, DARK), 0.0)


def board(
    camera: Lab,
    rng: np.random.Generator,
    place: tuple[float, float] = (0.5, 0.5),
    tile_px: float = TILE_PX,
) -> Board:
    """A board that faces the camera but for a random tilt.

    It is around the image's middle, or at another place as shares of the image's size.
    """
    size_px = np.array((camera.config.width_px, camera.config.height_px))
    pixel = place * size_px + rng.uniform(-6, 6, 2)
    if camera.config.fisheye is None:
        flat = cv2.undistortPoints(pixel.reshape(1, 1, 2), camera.K, camera.coefficients)
        ray, facing = np.append(flat.ravel(), 1.0), Rotation.identity()
    else:
        (ray,) = fisheye_rays(pixel[None], camera.K, camera.coefficients)
        facing, _ = Rotation.align_vectors(ray[None], np.array(((0.0, 0.0, 1.0),)))
    depth_m = camera.config.fx_px * TILE_M / tile_px
    tilt = Rotation.from_rotvec(rng.uniform(-0.3, 0.3, 3))
    turn = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi))
    return Board(
        R_map_board=camera.R_map_optical @ (facing * tilt * turn).as_matrix(),
        corner_m=camera.in_map(depth_m * ray[None])[0],
    )


def displacement_px(
    linear: NDArray[np.uint8], brightness: NDArray[np.float32], mask: NDArray[np.uint8]
) -> FloatArray:
    """(2,) how far an image of linear light is from where it is expected: (right, down).

    Moved by a small d, brightness b becomes b - d grad b; least squares find d, and a gain and an
    offset that change slowly over the image. OpenCV's own registration moves images by whole 32nds
    of a pixel, which is too coarse.
    """
    seen = cv2.GaussianBlur(linear.mean(axis=-1), (0, 0), 1.2)
    expected = cv2.GaussianBlur(brightness.astype(np.float64), (0, 0), 1.2)
    down, right = np.gradient(expected)
    y, x = np.indices(expected.shape) / max(expected.shape)
    slow = [np.ones_like(x), x, y]
    columns = [right, down, *(expected * each for each in slow), *slow]
    inside = cv2.erode(mask, np.ones((7, 7), np.uint8)) > 0
    system = np.stack([column[inside] for column in columns], axis=1)
    solution, *_ = np.linalg.lstsq(system, seen[inside], rcond=None)
    gain = solution[2] + solution[3] * x[inside].mean() + solution[4] * y[inside].mean()
    return np.asarray(-solution[:2] / gain)
