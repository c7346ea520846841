"""The images of one view, padded and flattened for integration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import invert
from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_mapping.voxels.config import TsdfConfig

MIN_FOCAL, MAX_FOCAL, MAX_CENTRE = 0.01, 1000.0, 100.0
"""Bounds of focal lengths and of the principal point, in image widths; those of the simulator."""
FARTHEST_M = 1e7
"""Distance of a camera from the map's origin; the numbers of blocks farther away have no room."""

UNKNOWN_M = -1e9
"""Depth of pixels without a measurement: every voxel is far behind it. NaN would spread."""

SAME_SURFACE_STEP = 0.2
"""Largest difference of neighbouring depths on one surface, as a share of the depth."""

MIN_COSINE = 0.05
"""Least cosine of the angle of incidence, as far as weights are concerned."""


@dataclass(frozen=True)
class PaddedImages:
    """A view's images, flat and with a border of one pixel without a measurement.

    A voxel takes the pixel whose centre is nearest to its projection. Voxels that project outside
    the image are assigned to the border, so that they need no check of their own.

    Attributes:
        row_px: Pixels in a row, border included.
        rows: Rows, border included.
        depth_m: (rows * row_px,) float32; `UNKNOWN_M` where there is no measurement, ``+inf``
            where the ray is free up to the range.
        weight: (rows * row_px,) float32; None: 1 everywhere.
        color: (rows * row_px,) uint32 with the bytes red, green, blue and 0; or None.
        labels: (rows * row_px,) uint16, or None.
        pixel_from_map: (3, 3) matrix and (3,) offset that map a point in ``map`` to (u z, v z, z),
            with u and v counted from the border's outer edge.
        max_range_m: Depth up to which a ray that hit nothing clears space.
    """

    row_px: int
    rows: int
    depth_m: NDArray[np.float32]
    weight: NDArray[np.float32] | None
    color: NDArray[np.uint32] | None
    labels: NDArray[np.uint16] | None
    pixel_from_map: tuple[FloatArray, FloatArray]
    max_range_m: float

    @property
    def free_depth_m(self) -> NDArray[np.float32]:
        """(H, W) depth up to which each ray is known to be free; 0 where nothing is known."""
        return np.clip(self.without_border(self.depth_m), 0, np.float32(self.max_range_m))

    def without_border(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return one of the images as (H, W)."""
        return image.reshape(self.rows, self.row_px)[1:-1, 1:-1]

    @property
    def map_from_pixel(self) -> tuple[FloatArray, FloatArray]:
        """(3, 3) matrix that maps z (column, row, 1) to ``map`` axes, and the camera's position."""
        matrix, offset = self.pixel_from_map
        inverse = np.linalg.inv(matrix)
        to_map = inverse.copy()
        to_map[:, 2] += 1.5 * (inverse[:, 0] + inverse[:, 1])
        return to_map, -inverse @ offset


def check_view(
    depth_m: NDArray[np.float32],
    rgb: NDArray[np.uint8] | None,
    labels: NDArray[np.uint16] | None,
    camera: PinholeIntrinsics,
    T_map_camera: FloatArray,
) -> None:
    """Raise InvalidInputError where images, camera and pose cannot be integrated."""
    size = (camera.height_px, camera.width_px)
    if depth_m.shape != size:
        raise InvalidInputError("depth_m", depth_m.shape, f"an image of shape {size}")
    if rgb is not None and rgb.shape != (*size, 3):
        raise InvalidInputError("rgb", rgb.shape, f"an image of shape {(*size, 3)}")
    if labels is not None and labels.shape != size:
        raise InvalidInputError("labels", labels.shape, f"an image of shape {size}")
    if not camera.is_rectilinear:
        received = (camera.distortion_model, camera.distortion)
        raise InvalidInputError("intrinsics.distortion", received, "a pinhole without any")
    least_px, most_px = (factor * camera.width_px for factor in (MIN_FOCAL, MAX_FOCAL))
    if not all(least_px <= focal_px <= most_px for focal_px in (camera.fx_px, camera.fy_px)):
        expected = f"focal lengths from {least_px:g} to {most_px:g} pixels"
        raise InvalidInputError("intrinsics", (camera.fx_px, camera.fy_px), expected)
    if max(abs(camera.cx_px), abs(camera.cy_px)) > MAX_CENTRE * camera.width_px:
        expected = f"a principal point within {MAX_CENTRE:g} image widths"
        raise InvalidInputError("intrinsics", (camera.cx_px, camera.cy_px), expected)
    if np.shape(T_map_camera) != (4, 4) or not np.isfinite(T_map_camera).all():
        raise InvalidInputError("T_map_camera", T_map_camera, "a finite (4, 4) transform")
    if np.abs(T_map_camera[:3, 3]).max() > FARTHEST_M:
        received = T_map_camera[:3, 3].tolist()
        raise InvalidInputError(
            "T_map_camera", received, f"at most {FARTHEST_M:g} m from the origin"
        )


def pad_images(
    depth_m: NDArray[np.float32],
    rgb: NDArray[np.uint8] | None,
    labels: NDArray[np.uint16] | None,
    camera: PinholeIntrinsics,
    T_map_camera: FloatArray,
    config: TsdfConfig,
) -> PaddedImages:
    """Return a view's images as `config` asks for them; for the arguments see `TsdfVolume`."""
    with np.errstate(invalid="ignore"):
        is_near = (depth_m > 0) & (depth_m < config.max_range_m)
        is_beyond = depth_m >= config.max_range_m
    measured_m = np.where(is_near, depth_m, np.float32(UNKNOWN_M))
    if config.clear_free_space:
        measured_m[is_beyond] = np.inf
    weight = None
    if config.weighting != "constant" or config.weigh_incidence:
        weight = _weights(np.where(is_near, depth_m, config.max_range_m), camera, config)
        weight = _pad(weight, 0)
    K = camera.K
    K[:2, 2] += 1.5  # Half a pixel turns truncation into rounding; one pixel is the border.
    T_camera_map = invert(T_map_camera)
    return PaddedImages(
        row_px=camera.width_px + 2,
        rows=camera.height_px + 2,
        depth_m=_pad(measured_m.astype(np.float32), UNKNOWN_M),
        weight=weight,
        color=None if rgb is None else _pad_color(rgb),
        labels=None if labels is None else _pad(labels, 0),
        pixel_from_map=(K @ T_camera_map[:3, :3], K @ T_camera_map[:3, 3]),
        max_range_m=config.max_range_m,
    )


def _weights(
    depth_m: NDArray[Any], camera: PinholeIntrinsics, config: TsdfConfig
) -> NDArray[np.float32]:
    is_constant = config.weighting == "constant"
    weight = np.ones_like(depth_m) if is_constant else 1 / np.square(depth_m)
    if config.weigh_incidence:
        weight = weight * _incidence_cosines(depth_m, camera)
    return weight.astype(np.float32)


def _incidence_cosines(depth_m: NDArray[Any], camera: PinholeIntrinsics) -> NDArray[Any]:
    """Return (H, W) cosines between ray and surface normal; the least where depth jumps."""
    v, u = np.indices(depth_m.shape)
    x, y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
    points_m = np.stack((x * depth_m, y * depth_m, depth_m), axis=-1)
    along_v, along_u = np.gradient(points_m, axis=(0, 1))
    normals = np.cross(along_u, along_v)
    length = np.linalg.norm(normals, axis=-1) * np.sqrt(x**2 + y**2 + 1)
    cosine = np.abs(normals[..., 0] * x + normals[..., 1] * y + normals[..., 2])
    cosine /= np.maximum(length, 1e-30)
    jump_m = np.maximum(np.abs(along_u[..., 2]), np.abs(along_v[..., 2]))
    cosine[jump_m > SAME_SURFACE_STEP * depth_m] = MIN_COSINE
    return np.asarray(np.maximum(cosine, MIN_COSINE))


def _pad(image: NDArray[Any], value: float) -> NDArray[Any]:
    return np.pad(image, 1, constant_values=value).ravel()


def _pad_color(rgb: NDArray[np.uint8]) -> NDArray[np.uint32]:
    height, width, _ = rgb.shape
    padded = np.zeros((height + 2, width + 2, 4), np.uint8)
    padded[1:-1, 1:-1, :3] = rgb
    return padded.view(np.uint32).ravel()
