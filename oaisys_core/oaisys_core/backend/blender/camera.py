"""A pinhole camera in Blender's terms."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from oaisys_core.geometry import transform
from oaisys_core.types import FloatArray, PinholeIntrinsics

T_OPTICAL_BLENDER: FloatArray = transform(np.diag((1.0, -1.0, -1.0)), (0.0, 0.0, 0.0))
"""Blender's camera looks along -z with y up; an optical frame along z with y down."""

SENSOR_WIDTH_MM = 36.0
CLIP_START_M = 1e-3
CLIP_END_M = 1e6


def new_camera() -> Any:
    """Return a camera in the scene, and make it the one that renders."""
    data = bpy.data.cameras.new("camera")
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = SENSOR_WIDTH_MM
    data.clip_start = CLIP_START_M
    data.clip_end = CLIP_END_M
    camera = bpy.data.objects.new("camera", data)
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    return camera


def place(camera: Any, T_map_camera: FloatArray) -> None:
    """Move a camera to the (4, 4) pose of its optical frame."""
    camera.matrix_world = Matrix(T_map_camera @ T_OPTICAL_BLENDER)


def set_intrinsics(camera: Any, intrinsics: PinholeIntrinsics) -> None:
    """Make a camera, and the render's size, so that pixel centres see what ``intrinsics`` say.

    Blender measures in widths of the image: with pixels of aspect a = fx / fy (height over
    width), the film is ``width`` wide and ``a * height`` high, and the optical axis meets it
    ``shift`` beside its centre. Its pixel centres are at +0.5, OpenCV's at integers.
    """
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y = intrinsics.width_px, intrinsics.height_px
    render.resolution_percentage = 100
    aspect = intrinsics.fx_px / intrinsics.fy_px
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, 1.0 / aspect), max(1.0, aspect)
    width = intrinsics.width_px
    data = camera.data
    data.lens = intrinsics.fx_px * SENSOR_WIDTH_MM / width
    data.shift_x = (width / 2 - intrinsics.cx_px - 0.5) / width
    data.shift_y = (intrinsics.cy_px + 0.5 - intrinsics.height_px / 2) * aspect / width
