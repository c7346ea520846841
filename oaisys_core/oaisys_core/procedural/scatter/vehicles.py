"""A rover and a lander made of simple solids: metres, x forward, ground at z = 0."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np

from oaisys_core.procedural.scatter.mesh_builder import MeshBuilder
from oaisys_core.procedural.scatter.vehicle_parts import access_panel, case, facing, foil, stripes
from oaisys_core.scene import MeshPrototype
from oaisys_core.types import FloatArray

WHITE, GREY, DARK = (0.80, 0.79, 0.76), (0.45, 0.45, 0.46), (0.10, 0.10, 0.11)
GOLD, FOIL_SHADE = (0.72, 0.52, 0.20), (0.55, 0.37, 0.12)
CELLS, GLASS, METAL = (0.06, 0.08, 0.20), (0.03, 0.03, 0.05), (0.30, 0.30, 0.32)

PLATE, SEAM = (0.71, 0.70, 0.67), (0.20, 0.20, 0.21)
ORANGE, BLUE, RED = (0.80, 0.36, 0.10), (0.10, 0.20, 0.45), (0.60, 0.10, 0.08)

ROVER_DUST_M, LANDER_DUST_M = 0.5, 0.6
"""Heights up to which the ground's dust lies on them."""

WHEEL_X = (0.85, 0.02, -0.80)
"""Axles of the rover's wheels, from the front."""

WHEEL_Y, WHEEL_RADIUS, WHEEL_WIDTH = 0.72, 0.25, 0.30


@cache
def rover() -> MeshPrototype:
    """Return a rover with six wheels on rocker arms, a camera mast, an arm and a power source.

    About 2.1 m long, 1.75 m wide and 1.9 m high.
    """
    parts = MeshBuilder()
    for side in (-1.0, 1.0):
        _running_gear(parts, side)
    case(parts, (0.05, 0, 0.72), (1.35, 0.92, 0.34), WHITE)
    case(parts, (0.05, 0, 0.905), (1.45, 1.02, 0.03), GREY)
    case(parts, (0.05, 0, 0.54), (1.05, 0.72, 0.04), DARK)
    for x, y in ((0.35, -0.25), (-0.1, 0.28), (-0.15, -0.2)):
        case(parts, (x, y, 0.95), (0.22, 0.2, 0.06), WHITE)
    _body_details(parts)
    for y in (-0.28, 0.28):
        parts.rod((0.72, y, 0.74), (0.76, y, 0.74), 0.045, GLASS, 10)
    _mast(parts)
    _power_source(parts)
    _dish(parts, np.array((-0.35, -0.32, 0.92)))
    parts.rod((-0.3, 0.38, 0.92), (-0.3, 0.38, 1.3), 0.035, WHITE, 8)
    _arm(parts)
    return parts.mesh("rover", ROVER_DUST_M)


@cache
def lander() -> MeshPrototype:
    """Return a lander on four legs, its body in gold foil, with solar wings and a dish.

    About 4.4 m wide with its wings and 2.9 m high.
    """
    parts = MeshBuilder()
    rng = np.random.default_rng(0)
    _prism(parts, 0.85, 1.55, 1.15, 1.15, GOLD, FOIL_SHADE, rng)
    _prism(parts, 1.55, 1.57, 1.19, 1.22, METAL, METAL)
    _prism(parts, 1.57, 1.60, 1.22, 1.22, METAL, METAL)
    _prism(parts, 1.60, 1.62, 1.22, 1.19, METAL, METAL)
    _prism(parts, 1.62, 2.15, 0.78, 0.60, WHITE, PLATE)
    _prism(parts, 0.75, 0.85, 0.90, 1.15, FOIL_SHADE, GOLD, rng)
    _marks(parts)
    parts.rod((0, 0, 0.35), (0, 0, 0.78), (0.40, 0.16), DARK, 20)
    for quarter in range(4):
        _leg(parts, np.pi / 4 + quarter * np.pi / 2)
    for angle in (0.0, np.pi / 2, np.pi, 1.5 * np.pi):
        way = np.array((np.cos(angle), np.sin(angle), 0.0))
        parts.rod(0.78 * way + _xyz(0, 0, 1.62), 0.78 * way + _xyz(0, 0, 1.98), 0.17, GREY, 14)
    for side in (-1.0, 1.0):
        parts.rod((0, side * 0.6, 1.85), (0, side * 1.25, 1.95), 0.035, METAL, 8)
        _panel(parts, np.array((0.0, side * 1.85, 1.98)), (1.1, 1.2), np.radians(12) * side)
    parts.rod((0.25, 0, 2.15), (0.25, 0, 2.55), 0.03, METAL, 8)
    _dish(parts, np.array((0.25, 0, 2.5)), radius_m=0.34)
    parts.rod((-0.3, 0.2, 2.15), (-0.3, 0.2, 2.9), (0.02, 0.008), METAL, 6)
    case(parts, (0.98, 0, 1.2), (0.36, 0.5, 0.03), METAL, _pitch(0.6))
    for rung in range(6):
        z = 0.15 + 0.16 * rung
        parts.rod((1.52 - 0.3 * z, -0.16, z), (1.52 - 0.3 * z, 0.16, z), 0.015, METAL, 6)
    for y in (-0.16, 0.16):
        parts.rod((1.5, y, 0.02), (1.18, y, 1.1), 0.018, METAL, 6)
    return parts.mesh("lander", LANDER_DUST_M)


def _body_details(parts: MeshBuilder) -> None:
    """Add the plates, seams and marks of the rover's body and deck."""
    for side, axis in ((-1.0, "-y"), (1.0, "+y")):
        R, y = facing(axis), side * 0.46
        for x, width_m in ((-0.38, 0.40), (0.05, 0.36), (0.46, 0.36)):
            access_panel(parts, (x, y, 0.74), (width_m, 0.24), PLATE, R)
        stripes(parts, (0.46, y + side * 0.007, 0.79), (0.18, 0.05), (ORANGE, WHITE, BLUE), R)
        parts.box((0.05, y, 0.595), (1.25, 0.012, 0.012), SEAM)
    access_panel(parts, (0.725, 0.0, 0.65), (0.5, 0.14), PLATE, facing("+x"))
    for y in (-0.16, 0.16):
        parts.box((0.05, y, 0.921), (1.4, 0.008, 0.004), SEAM)
    # The target for calibrating the cameras' colours.
    case(parts, (0.18, 0.36, 0.93), (0.12, 0.12, 0.02), DARK)
    colors = ((RED, ORANGE), (BLUE, WHITE))
    for row, line in enumerate(colors):
        for column, color in enumerate(line):
            place = (0.155 + 0.05 * column, 0.335 + 0.05 * row, 0.941)
            parts.box(place, (0.04, 0.04, 0.004), color)
    for y in (-0.3, -0.26):
        sag = np.array(((-0.62, y, 0.80), (-0.78, y, 0.70), (-0.9, y * 0.6, 0.80)))
        parts.tube(sag, 0.012, DARK, 6)


def _running_gear(parts: MeshBuilder, side: float) -> None:
    """Add the three wheels and the rocker and bogie of one side."""
    y = side * WHEEL_Y
    axles = [np.array((x, y, WHEEL_RADIUS)) for x in WHEEL_X]
    for axle in axles:
        _wheel(parts, axle)
    inner = np.array((0.0, side * 0.54, 0.0))
    rocker, bogie = inner + _xyz(0.1, 0, 0.68), inner + _xyz(-0.42, 0, 0.55)
    foot = [inner + _xyz(x, 0, WHEEL_RADIUS + 0.28) for x in WHEEL_X]
    for start, end in (
        (rocker, foot[0]),
        (rocker, bogie),
        (bogie, foot[1]),
        (bogie, foot[2]),
    ):
        parts.rod(start, end, 0.035, GREY, 8)
    for axle, top in zip(axles, foot, strict=True):
        hub = np.array((axle[0], side * 0.54, WHEEL_RADIUS))
        parts.rod(top, hub, 0.03, GREY, 8)
        parts.rod(hub, axle, 0.045, METAL, 8)
    parts.rod(rocker - _xyz(0, side * 0.12, 0), rocker + _xyz(0, side * 0.04, 0), 0.07, METAL, 12)


def _wheel(parts: MeshBuilder, axle: FloatArray) -> None:
    """Add a wheel with cleats."""
    from scipy.spatial.transform import Rotation

    half = np.array((0.0, WHEEL_WIDTH / 2, 0.0))
    flat, edge = 0.85 * half, WHEEL_RADIUS - 0.012
    parts.rod(axle - flat, axle + flat, edge, METAL, 32)
    for face in (-1.0, 1.0):
        parts.rod(axle + face * flat, axle + face * half, (edge, edge - 0.018), METAL, 32)
    for face in (-1.0, 1.0):
        rim = axle + face * half
        parts.rod(rim, rim + _xyz(0, face * 0.004, 0), WHEEL_RADIUS - 0.05, DARK, 20)
        parts.rod(rim, rim + _xyz(0, face * 0.03, 0), 0.07, GREY, 10)
        for angle in np.arange(5) * (2 * np.pi / 5):
            spoke = np.array((np.cos(angle), 0.0, np.sin(angle)))
            end = rim + spoke * (WHEEL_RADIUS - 0.04)
            parts.rod(
                rim + _xyz(0, face * 0.012, 0), end + _xyz(0, face * 0.006, 0), 0.014, GREY, 6
            )
    for angle in np.arange(20) * (2 * np.pi / 20):
        out = np.array((np.cos(angle), 0.0, np.sin(angle)))
        turn = Rotation.from_euler("y", -angle).as_matrix()
        centre = axle + (WHEEL_RADIUS - 0.008) * out
        case(parts, centre, (0.016, WHEEL_WIDTH, 0.016), DARK, turn)


def _mast(parts: MeshBuilder) -> None:
    foot = np.array((0.52, 0.30, 0.92))
    parts.rod(foot, foot + _xyz(0, 0, 0.10), 0.07, GREY, 12)
    parts.rod(foot + _xyz(0, 0, 0.1), foot + _xyz(0, 0, 0.75), 0.04, WHITE, 12)
    head = foot + _xyz(0.03, 0, 0.83)
    case(parts, head, (0.16, 0.36, 0.18), WHITE)
    access_panel(parts, head - _xyz(0.08, 0, 0), (0.26, 0.12), PLATE, facing("-x"))
    parts.rod(head + _xyz(0.08, 0, 0.02), head + _xyz(0.10, 0, 0.02), 0.065, GLASS, 14)
    for y in (-0.12, 0.12):
        case(parts, head + _xyz(0.09, y, -0.03), (0.04, 0.07, 0.08), GREY)
        parts.rod(head + _xyz(0.11, y, -0.03), head + _xyz(0.12, y, -0.03), 0.025, GLASS, 10)


def _power_source(parts: MeshBuilder) -> None:
    """Add a finned generator at the back, tilted up."""
    start, end = np.array((-0.66, 0.0, 0.74)), np.array((-1.12, 0.0, 0.90))
    parts.rod(start, end, 0.12, GREY, 14)
    along = (end - start) / np.linalg.norm(end - start)
    other = np.cross(along, (0.0, 1.0, 0.0))
    for angle in np.arange(8) * (np.pi / 4):
        out = np.cos(angle) * np.array((0.0, 1.0, 0.0)) + np.sin(angle) * other
        R = np.column_stack((along, out, np.cross(along, out)))
        case(parts, (start + 1.1 * end) / 2.1 + 0.16 * out, (0.38, 0.14, 0.015), GREY, R)


def _arm(parts: MeshBuilder) -> None:
    """Add an arm folded at the front."""
    joints = np.array(((0.74, -0.25, 0.70), (1.12, -0.25, 0.80), (1.02, 0.12, 0.58)))
    for start, end in pairwise(joints):
        parts.rod(start, end, 0.035, GREY, 10)
    for joint in joints:
        parts.rod(joint - _xyz(0, 0, 0.06), joint + _xyz(0, 0, 0.06), 0.05, METAL, 10)
    parts.rod(joints[-1], joints[-1] + _xyz(0.02, 0.16, -0.02), 0.09, METAL, 12)
    parts.rod(joints[-1] + _xyz(0, 0.1, 0), joints[-1] + _xyz(0.1, 0.12, -0.08), 0.03, DARK, 8)


def _dish(parts: MeshBuilder, foot: FloatArray, radius_m: float = 0.17) -> None:
    """Add a dish on a stalk, looking up and back."""
    axis = np.array((-0.5, 0.0, 0.87))
    centre = foot + _xyz(0.0, 0.0, 0.18)
    parts.rod(foot, centre, 0.022, METAL, 8)
    parts.rod(centre, centre + 0.3 * radius_m * axis, (0.25 * radius_m, radius_m), WHITE, 20)
    parts.rod(centre, centre + 0.75 * radius_m * axis, 0.012, METAL, 6)


def _leg(parts: MeshBuilder, azimuth: float) -> None:
    """Add a leg with its struts and pad."""
    way = np.array((np.cos(azimuth), np.sin(azimuth), 0.0))
    side = np.array((-np.sin(azimuth), np.cos(azimuth), 0.0))
    pad = 1.85 * way
    knee = 1.45 * way + _xyz(0, 0, 0.75)
    parts.rod(pad, pad + _xyz(0, 0, 0.06), (0.24, 0.18), GOLD, 18)
    parts.rod(pad + _xyz(0, 0, 0.05), 1.12 * way + _xyz(0, 0, 1.5), 0.05, METAL, 10)
    for sign in (-1.0, 1.0):
        parts.rod(knee, 1.0 * way + sign * 0.5 * side + _xyz(0, 0, 0.95), 0.03, METAL, 8)
    parts.rod(knee - 0.02 * way, knee + 0.12 * way - _xyz(0, 0, 0.23), 0.065, GOLD, 10)


def _marks(parts: MeshBuilder) -> None:
    """Add plates and stripes to the lander's upper stage, and thrusters to its corners."""
    lean = np.arctan2(0.18, 0.53)
    apothem_m = 0.69 * np.cos(np.pi / 8)
    for eighth in range(8):
        angle = eighth * np.pi / 4
        turn = _yaw(angle) @ _pitch(-lean) @ facing("+x")
        place = _yaw(angle) @ _xyz(apothem_m, 0, 1.885)
        access_panel(parts, place, (0.36, 0.38), PLATE if eighth % 2 else WHITE, turn)
        if eighth % 4 == 1:
            colors = (BLUE, WHITE, RED)
            stripes(
                parts, place + 0.008 * turn[:, 2] + 0.08 * turn[:, 1], (0.2, 0.12), colors, turn
            )
        corner = _yaw(angle + np.pi / 8) @ _xyz(1.16, 0, 1.66)
        if eighth % 2:
            case(parts, corner, (0.1, 0.1, 0.09), GREY, _yaw(angle + np.pi / 8))
            for way in (-1.0, 1.0):
                out = _yaw(angle + np.pi / 8) @ _xyz(0.0, way, 0.0)
                parts.rod(corner + 0.05 * out, corner + 0.12 * out, (0.018, 0.04), DARK, 12)


def _prism(
    parts: MeshBuilder,
    low_m: float,
    high_m: float,
    low_radius_m: float,
    high_radius_m: float,
    color: tuple[float, float, float],
    other: tuple[float, float, float],
    rng: np.random.Generator | None = None,
) -> None:
    """Add an octagonal body whose sides alternate between two colours.

    With a random generator, its sides are covered with foil.
    """
    angle = np.arange(8) * (np.pi / 4) + np.pi / 8
    way = np.column_stack((np.cos(angle), np.sin(angle)))
    low = np.column_stack((low_radius_m * way, np.full(8, low_m)))
    high = np.column_stack((high_radius_m * way, np.full(8, high_m)))
    for i in range(8):
        j = (i + 1) % 8
        corners = np.array((low[i], low[j], high[j], high[i]))
        if rng is None:
            parts.add(corners, [(0, 1, 2), (0, 2, 3)], color if i % 2 else other)
        else:
            foil(parts, corners, color if i % 2 else other, rng)
    fan = np.array([(0, i, i + 1) for i in range(1, 7)])
    parts.add(high, fan, color)
    parts.add(low, fan[:, ::-1], other)


def _panel(
    parts: MeshBuilder, centre: FloatArray, size_m: tuple[float, float], roll_rad: float
) -> None:
    """Add a solar panel with its rows of cells."""
    from scipy.spatial.transform import Rotation

    R = Rotation.from_euler("x", roll_rad).as_matrix()
    case(parts, centre, (*size_m, 0.025), METAL, R)
    cells = 4
    pitch = np.array(size_m) / cells
    for i in range(cells):
        for j in range(cells):
            offset = np.array(((i - 1.5) * pitch[0], (j - 1.5) * pitch[1], 0.016))
            parts.box(centre + R @ offset, (0.94 * pitch[0], 0.94 * pitch[1], 0.008), CELLS, R)


def _xyz(x: float, y: float, z: float) -> FloatArray:
    return np.array((x, y, z))


def _yaw(angle_rad: float) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("z", angle_rad).as_matrix())


def _pitch(angle_rad: float) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("y", angle_rad).as_matrix())


VEHICLES = {"rover": rover, "lander": lander}
