"""Blender's camera: pose, intrinsics, aperture, motion blur, lens distortion, size of a pixel."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from math import ceil, isclose, sqrt
from typing import Any, NamedTuple

import bpy
import cv2
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from oaisys_core.geometry import T_OPTICAL_BLENDER, pixel_rays
from oaisys_core.render.blender.fisheye import Pixel, fisheye_image, fisheye_to_render, set_fisheye
from oaisys_core.scene import Lens, PlacedCamera
from oaisys_core.types import FloatArray, PinholeIntrinsics

SENSOR_WIDTH_MM = 36.0
CLIP_START_M = 1e-3
CLIP_END_M = 1e6

BEGIN_FRAME, END_FRAME = 1, 2
"""Blender's animation frames between which a camera moves while its shutter is open."""

MARGIN_PX = 3
"""Border of a pinhole image that is rendered for a lens, for interpolation."""

MAX_PIXEL_RATIO = 4.0
"""A pinhole image rendered for a lens has at most so many times the lens image's pixels."""


def new_camera() -> Any:
    """Add a camera to the scene and make it the active one."""
    data = bpy.data.cameras.new("camera")
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = SENSOR_WIDTH_MM
    data.clip_start = CLIP_START_M
    data.clip_end = CLIP_END_M
    camera = bpy.data.objects.new("camera", data)
    camera.rotation_mode = "QUATERNION"
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    return camera


def place(camera: Any, T_map_camera: FloatArray) -> None:
    """Move a camera's optical frame to a (4, 4) pose."""
    camera.matrix_world = Matrix(T_map_camera @ T_OPTICAL_BLENDER)


def set_lens(camera: Any, lens: Lens | None) -> None:
    """Set a camera's aperture; None: a pinhole.

    The f-number refers to a sensor `SENSOR_WIDTH_MM` wide.
    """
    dof = camera.data.dof
    dof.use_dof = lens is not None
    if lens is None:
        return
    dof.focus_distance = lens.focus_distance_m
    dof.aperture_fstop = lens.f_number
    dof.aperture_blades = lens.blades
    dof.aperture_rotation = lens.blade_rotation_rad
    dof.aperture_ratio = lens.ratio


class ShutterMotion(NamedTuple):
    """How a camera moves while an image is taken.

    Attributes:
        T_map_begin, T_map_end: (4, 4) poses of the optical frame between which it moves.
        open_share: Last share of the way during which the shutter is open.
        row_share: Share of the way during which each row is exposed, from top to bottom; None: all
            rows are exposed together.
    """

    T_map_begin: FloatArray
    T_map_end: FloatArray
    open_share: float = 1.0
    row_share: float | None = None


def shutter_motion(
    camera: PlacedCamera, complete: PinholeIntrinsics, rendered: PinholeIntrinsics
) -> ShutterMotion | None:
    """Return how a camera moves while an image is rendered; None if it does not.

    Args:
        camera: The camera.
        complete: What is rendered for it, see `pinhole_to_render`.
        rendered: The same with fewer pixels.
    """
    if camera.pose_at is None or not (camera.readout_s or camera.exposure_s):
        if camera.T_map_previous is None or camera.shutter_share == 0:
            return None
        return ShutterMotion(camera.T_map_previous, camera.T_map_camera, camera.shutter_share)
    row_s = camera.readout_s / max(camera.intrinsics.height_px - 1, 1)
    # Cycles renders row i of N at the share (i + 1) / N of the time that all rows take.
    scale = complete.height_px / rendered.height_px
    above_px = complete.cy_px - camera.intrinsics.cy_px
    begin_s = -row_s * (above_px + 0.5 + scale / 2) - camera.exposure_s / 2
    duration_s = row_s * complete.height_px + camera.exposure_s
    T_begin, T_end = camera.pose_at(np.array((begin_s, begin_s + duration_s)))
    row_share = camera.exposure_s / duration_s if row_s else None
    return ShutterMotion(T_begin, T_end, row_share=row_share)


@contextmanager
def moving(camera: Any, motion: ShutterMotion | None) -> Iterator[None]:
    """Move a camera during renders, as its shutter sees it. Objects do not move."""
    if motion is None:
        yield
        return
    scene = bpy.context.scene
    before = camera.matrix_world.copy()
    frames = ((BEGIN_FRAME, motion.T_map_begin), (END_FRAME, motion.T_map_end))
    # Linear interpolation, set in the one way that both versions of Blender understand.
    edit = bpy.context.preferences.edit
    edit.keyframe_new_interpolation_type = "LINEAR"
    last = None
    for frame, T_map_camera in frames:
        place, turn, _ = Matrix(T_map_camera @ T_OPTICAL_BLENDER).decompose()
        if last is not None and last.dot(turn) < 0:
            turn.negate()
        camera.location, camera.rotation_quaternion, last = place, turn, turn
        camera.keyframe_insert("location", frame=frame)
        camera.keyframe_insert("rotation_quaternion", frame=frame)
    scene.render.use_motion_blur = True
    scene.render.motion_blur_shutter = motion.open_share
    scene.render.motion_blur_position = "END"
    if motion.row_share is not None:
        scene.cycles.rolling_shutter_type = "TOP"
        scene.cycles.rolling_shutter_duration = motion.row_share
    scene.frame_set(END_FRAME)
    try:
        yield
    finally:
        scene.render.use_motion_blur = False
        scene.cycles.rolling_shutter_type = "NONE"
        camera.animation_data_clear()
        camera.matrix_world = before


def set_intrinsics(camera: Any, intrinsics: PinholeIntrinsics) -> None:
    """Set a camera's lens and the render's size to the given intrinsics.

    Blender measures in widths of the image: with pixels of aspect a = fx / fy (height over
    width), the sensor is ``width`` wide and ``a * height`` high, and the principal point is
    ``shift`` beside its centre. Blender's pixel centres are at +0.5, OpenCV's at integers.
    """
    render = bpy.context.scene.render
    aspect = intrinsics.fx_px / intrinsics.fy_px
    width = intrinsics.width_px
    _set(
        render,
        resolution_x=width,
        resolution_y=intrinsics.height_px,
        resolution_percentage=100,
        pixel_aspect_x=max(1.0, 1.0 / aspect),
        pixel_aspect_y=max(1.0, aspect),
    )
    data = camera.data
    if intrinsics.is_fisheye:
        set_fisheye(data, intrinsics)
        return
    if data.type != "PERSP":
        data.type = "PERSP"
    data.lens = intrinsics.fx_px * SENSOR_WIDTH_MM / width
    data.shift_x = (width / 2 - intrinsics.cx_px - 0.5) / width
    data.shift_y = (intrinsics.cy_px + 0.5 - intrinsics.height_px / 2) * aspect / width


def _set(owner: Any, **values: float) -> None:
    """Set only what differs, because any assignment has Cycles update the whole scene."""
    for name, value in values.items():
        if not isclose(getattr(owner, name), value, rel_tol=1e-7):
            setattr(owner, name, value)


def pinhole_to_render(intrinsics: PinholeIntrinsics) -> PinholeIntrinsics:
    """Return what is rendered for a camera: its own intrinsics, unless it distorts.

    For a fisheye, it is another fisheye.
    """
    if intrinsics.is_fisheye:
        return fisheye_to_render(intrinsics)
    return covering_pinhole(intrinsics) if any(intrinsics.distortion) else intrinsics


def covering_pinhole(intrinsics: PinholeIntrinsics) -> PinholeIntrinsics:
    """Return a pinhole camera in the same optical frame that sees everything a lens sees.

    Its resolution is at least the lens's, as far as `MAX_PIXEL_RATIO` allows.
    """
    rays = pixel_rays(intrinsics)[..., :2]
    low, high = rays.min(axis=(0, 1)), rays.max(axis=(0, 1))
    finest = (np.diff(rays[..., 0], axis=1).min(), np.diff(rays[..., 1], axis=0).min())
    focal_px = 1.0 / np.array(finest)
    size_px = (high - low) * focal_px + 1 + 2 * MARGIN_PX
    surplus = size_px.prod() / (MAX_PIXEL_RATIO * intrinsics.width_px * intrinsics.height_px)
    if surplus > 1:
        focal_px /= sqrt(surplus)
        size_px = (high - low) * focal_px + 1 + 2 * MARGIN_PX
    cx_px, cy_px = MARGIN_PX - low * focal_px
    width, height = (ceil(size) for size in size_px.tolist())
    fx_px, fy_px = focal_px.tolist()
    return PinholeIntrinsics(width, height, fx_px, fy_px, float(cx_px), float(cy_px))


def scale_pinhole(pinhole: PinholeIntrinsics, scale: float) -> PinholeIntrinsics:
    """Return a camera with the same field of view and ``scale`` times the pixels per side."""
    if scale == 1.0:
        return pinhole
    width_px = max(1, round(pinhole.width_px * scale))
    height_px = max(1, round(pinhole.height_px * scale))
    across, down = width_px / pinhole.width_px, height_px / pinhole.height_px
    return replace(
        pinhole,
        width_px=width_px,
        height_px=height_px,
        fx_px=pinhole.fx_px * across,
        fy_px=pinhole.fy_px * down,
        # Pixel centres are at integers, so the image's edge is at -0.5.
        cx_px=(pinhole.cx_px + 0.5) * across - 0.5,
        cy_px=(pinhole.cy_px + 0.5) * down - 0.5,
    )


def camera_image(
    image: NDArray[Pixel], pinhole: PinholeIntrinsics, intrinsics: PinholeIntrinsics
) -> NDArray[Pixel]:
    """Return a camera's image of one that its `pinhole_to_render` sees, which may be smaller.

    It is of bytes, or of floats that are not negative.
    """
    found = _resampled(image, pinhole, intrinsics)
    # Cubic interpolation may fall below 0.
    return found if found.dtype == np.uint8 else np.maximum(found, 0)


def _resampled(
    image: NDArray[Pixel], pinhole: PinholeIntrinsics, intrinsics: PinholeIntrinsics
) -> NDArray[Pixel]:
    size = pinhole.width_px, pinhole.height_px
    if image.shape[1::-1] != size:
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC))
    if intrinsics.is_fisheye:
        return fisheye_image(image, pinhole, intrinsics)
    if pinhole is intrinsics:
        return image
    rays = pixel_rays(intrinsics)
    u = (rays[..., 0] * pinhole.fx_px + pinhole.cx_px).astype(np.float32)
    v = (rays[..., 1] * pinhole.fy_px + pinhole.cy_px).astype(np.float32)
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))
