"""Gazebo's cameras: ``<camera>`` of SDF, also inside of URDF."""

from __future__ import annotations

import math

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.calibrations.records import CalibratedCamera, image_size
from oaisys_core.files.calibrations.robots.elements import XmlElement
from oaisys_core.files.calibrations.robots.noise import read_noise
from oaisys_core.files.calibrations.robots.records import Notes
from oaisys_core.geometry import T_LINK_OPTICAL
from oaisys_core.types import FloatArray

RGB, DEPTH, LABELS = ("rgb",), ("depth",), ("semantic_0",)
MODALITIES = {
    "camera": RGB,
    "multicamera": RGB,
    "wideanglecamera": RGB,
    "depth": DEPTH,
    "depth_camera": DEPTH,
    "rgbd": (*RGB, *DEPTH),
    "rgbd_camera": (*RGB, *DEPTH),
    "segmentation": LABELS,
    "segmentation_camera": LABELS,
}
"""What a camera of each type measures."""

WIDE = "wideanglecamera"
FORMATS = ("R8G8B8", "RGB_INT8", "B8G8R8", "BGR_INT8", "R_FLOAT32", "FLOAT32")
DEFAULT_FOV_RAD, DEFAULT_WIDTH, DEFAULT_HEIGHT = 1.047, 320.0, 240.0
"""Those of SDF where the file says nothing."""

HALF = 0.5
LENSES = ("equidistant", "gnomonical")

PlainCoefficients = tuple[dict[str, float], dict[str, float] | None]


def read_camera(
    camera: XmlElement,
    name: str,
    kind: str,
    T_base_sensor: FloatArray,
    rate_hz: float | None,
    notes: Notes,
) -> CalibratedCamera:
    """Return a camera, which looks along x of its sensor, whatever its ``optical_frame_id`` is.

    Raises:
        InvalidInputError: A number is wrong, or we lack its lens.
    """
    size_px = _size(camera, name, notes)
    lens = camera.child("lens")
    fov_rad = camera.number("horizontal_fov", 0.0)
    if not fov_rad:
        fov_rad = DEFAULT_FOV_RAD
        notes.add(f"{name}: no horizontal_fov, SDF's default of {DEFAULT_FOV_RAD} rad is used")
    if kind == WIDE and lens is not None:
        focal_px, coefficients = _wide_lens(lens, fov_rad, size_px[0], name, notes)
        centre_px = None
    else:
        focal_px, centre_px = _pinhole(camera, lens, fov_rad, size_px[0], name, notes)
        coefficients = (_distortion(camera, name, notes), None)
    stddev = read_noise(camera).stddev
    if stddev:
        notes.add(
            f"{name}: noise of {stddev:g} of white is not used; render.effects.sensor_noise has"
            " that of an image sensor"
        )
    return CalibratedCamera(
        name,
        size_px,
        focal_px,
        centre_px,
        *coefficients,
        T_base_optical=T_base_sensor @ T_LINK_OPTICAL,
        rate_hz=rate_hz,
        modalities=_modalities(camera, kind),
    )


def read_depth_range_m(camera: XmlElement) -> tuple[float, float] | None:
    """Return the least and the greatest depth that a camera measures; None if it does not say."""
    inner = camera.child("depth_camera")
    clip = (None if inner is None else inner.child("clip")) or camera.child("clip")
    if clip is None:
        return None
    near_m, far_m = clip.number("near", 0.1), clip.number("far", 100.0)
    if not 0 <= near_m < far_m:
        raise InvalidInputError(clip.where, f"{near_m:g} to {far_m:g}", "near below far")
    return near_m, far_m


def _modalities(camera: XmlElement, kind: str) -> tuple[str, ...]:
    found = MODALITIES[kind]
    if found == LABELS and camera.value("segmentation_type", "semantic") != "semantic":
        return (*found, "instance")
    return found


def _size(camera: XmlElement, name: str, notes: Notes) -> tuple[int, int]:
    image = camera.child("image")
    if image is None:
        notes.add(f"{name}: no image size, SDF's default of 320 x 240 is used")
        return int(DEFAULT_WIDTH), int(DEFAULT_HEIGHT)
    width, height = image.number("width", DEFAULT_WIDTH), image.number("height", DEFAULT_HEIGHT)
    if (form := image.value("format", FORMATS[0])) not in FORMATS:
        notes.add(f"{name}: its image format {form} is not used: images are rgb8, depth 32FC1")
    return image_size(width, height, image.where)


def _pinhole(
    camera: XmlElement,
    lens: XmlElement | None,
    fov_rad: float,
    width: int,
    name: str,
    notes: Notes,
) -> tuple[tuple[float, float], tuple[float, float] | None]:
    """Return focal lengths and the principal point."""
    intrinsics = None if lens is None else lens.child("intrinsics")
    if intrinsics is not None:
        fx, fy, cx, cy = (intrinsics.number(key) for key in ("fx", "fy", "cx", "cy"))
        if skew := intrinsics.number("s", 0.0):
            notes.add(f"{name}: its skew of {skew:g} is not used: pixels are rectangles")
        notes.add(
            f"{name}: <intrinsics> count, not horizontal_fov; its principal point is half a pixel"
            " less than in the file, whose pixels begin at 0"
        )
        return (fx, fy), (cx - HALF, cy - HALF)
    if not 0 < fov_rad < math.pi:
        expected = f"above 0 and below pi; a {WIDE} may see more"
        raise InvalidInputError(camera.where, f"horizontal_fov {fov_rad:g}", expected)
    focal = width / (2 * math.tan(fov_rad / 2))
    return (focal, focal), None


def _wide_lens(
    lens: XmlElement, fov_rad: float, width: int, name: str, notes: Notes
) -> tuple[tuple[float, float], PlainCoefficients]:
    """Return focal lengths and coefficients of a lens, by its type."""
    kind = lens.value("type", "stereographic")
    if kind not in LENSES:
        expected = f"{' or '.join(LENSES)}; we have no other lens of Gazebo"
        raise InvalidInputError(lens.where, f"type {kind!r}", expected)
    if lens.value("scale_to_hfov", "true") not in ("true", "1"):
        raise InvalidInputError(lens.where, "scale_to_hfov false", "true")
    if kind == "gnomonical":
        if fov_rad >= math.pi:
            raise InvalidInputError(lens.where, f"horizontal_fov {fov_rad:g}", "below pi")
        focal, fisheye = width / (2 * math.tan(fov_rad / 2)), None
    else:
        focal, fisheye = width / fov_rad, dict.fromkeys(("k1", "k2", "k3", "k4"), 0.0)
    notes.add(f"{name}: its {kind} lens fills the image, also beyond cutoff_angle")
    lens.all("cutoff_angle", "env_texture_size")
    return (focal, focal), ({}, fisheye)


def _distortion(camera: XmlElement, name: str, notes: Notes) -> dict[str, float]:
    found = camera.child("distortion")
    if found is None:
        return {}
    values = {key: found.number(key, 0.0) for key in ("k1", "k2", "p1", "p2", "k3")}
    centre = found.child("center")
    if centre is not None and centre.numbers(2) != [HALF, HALF]:
        expected = "0.5 0.5, the principal point: we have no other centre of distortion"
        raise InvalidInputError(centre.where, centre.text, expected)
    if any(values.values()):
        notes.add(
            f"{name}: its distortion is that of plumb_bob, as Gazebo's ROS plugins publish it"
        )
    return values
