"""Trajectories against closed forms and finite differences, and in files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import transform
from oaisys_core.trajectory import RigMotion, Trajectory
from oaisys_core.trajectory.files import read_trajectory, write_trajectory
from oaisys_core.types import FloatArray

RADIUS_M, TURN_RAD_S, RISE_M_S = 4.0, 0.5, 0.3
KNOTS_S = np.linspace(2.0, 12.0, 201)
INNER_S = np.linspace(3.0, 11.0, 333)


def screw_positions_m(times_s: FloatArray) -> FloatArray:
    angle = TURN_RAD_S * times_s
    return np.column_stack((RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle), RISE_M_S * times_s))


def screw_rotations(times_s: FloatArray) -> Rotation:
    """Forward is along the circle, with a constant roll that tilts the axis of rotation."""
    return Rotation.from_euler(
        "ZX", np.column_stack((TURN_RAD_S * times_s + np.pi / 2, np.full(len(times_s), 0.4)))
    )


def screw() -> Trajectory:
    return Trajectory(KNOTS_S, screw_positions_m(KNOTS_S), screw_rotations(KNOTS_S).as_quat())


def wild() -> Trajectory:
    """A trajectory through a few random poses."""
    rng = np.random.default_rng(5)
    times_s = np.cumsum(rng.uniform(0.5, 1.5, 9))
    turns = Rotation.from_rotvec(np.cumsum(rng.uniform(-0.5, 0.5, (9, 3)), axis=0))
    return Trajectory(times_s, rng.uniform(-3, 3, (9, 3)), turns.as_quat())


def test_a_screw_has_the_derivatives_of_its_closed_form() -> None:
    angle = TURN_RAD_S * INNER_S
    outwards = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(len(angle))))
    along = np.column_stack((-np.sin(angle), np.cos(angle), np.zeros(len(angle))))
    made = screw()
    assert made.position_m(INNER_S) == pytest.approx(screw_positions_m(INNER_S), abs=1e-6)
    velocity = RADIUS_M * TURN_RAD_S * along + (0.0, 0.0, RISE_M_S)
    assert made.velocity_m_s(INNER_S) == pytest.approx(velocity, abs=1e-5)
    centripetal = -RADIUS_M * TURN_RAD_S**2 * outwards
    assert made.acceleration_m_s2(INNER_S) == pytest.approx(centripetal, abs=2e-4)
    error = made.rotation(INNER_S).inv() * screw_rotations(INNER_S)
    assert error.magnitude().max() < 1e-9
    rate = screw_rotations(INNER_S).inv().apply((0.0, 0.0, TURN_RAD_S))
    assert made.angular_rate_rad_s(INNER_S) == pytest.approx(rate, abs=1e-9)
    assert np.abs(made.angular_acceleration_rad_s2(INNER_S)).max() < 1e-9


def test_derivatives_are_those_of_finite_differences() -> None:
    made, h = wild(), 1e-4
    times_s = np.linspace(made.start_s + 0.1, made.end_s - 0.1, 101)
    before, after = times_s - h, times_s + h
    for value, derivative, tolerance in (
        (made.position_m, made.velocity_m_s, 1e-5),
        (made.velocity_m_s, made.acceleration_m_s2, 1e-2),
        (made.angular_rate_rad_s, made.angular_acceleration_rad_s2, 1e-2),
    ):
        difference = (value(after) - value(before)) / (2 * h)
        assert difference == pytest.approx(derivative(times_s), abs=tolerance)
    turned = (made.rotation(before).inv() * made.rotation(after)).as_rotvec() / (2 * h)
    assert turned == pytest.approx(made.angular_rate_rad_s(times_s), abs=1e-5)


def test_accelerations_are_continuous_at_the_given_poses() -> None:
    made = wild()
    inner_s, tiny_s = made.times_s[1:-1], 1e-7
    for acceleration in (made.acceleration_m_s2, made.angular_acceleration_rad_s2):
        jump = acceleration(inner_s + tiny_s) - acceleration(inner_s - tiny_s)
        assert np.abs(jump).max() < 1e-4
        assert np.abs(acceleration(inner_s)).max() > 0.1


def test_a_mounted_sensor_has_the_pose_of_its_mount_at_each_time() -> None:
    made = wild()
    T_base_sensor = transform(Rotation.from_euler("y", 0.3).as_matrix(), (0.2, -0.1, 0.5))
    times_s = np.linspace(made.start_s, made.end_s, 7)
    T_map_sensor = made.mount(T_base_sensor)(times_s)
    assert T_map_sensor.shape == (7, 4, 4)
    at = made.rotation(times_s).apply(T_base_sensor[:3, 3]) + made.position_m(times_s)
    assert T_map_sensor[:, :3, 3] == pytest.approx(at, abs=1e-12)
    assert T_map_sensor[3] == pytest.approx(made.T_map_base(times_s[3])[0] @ T_base_sensor)
    assert T_map_sensor[:, 3] == pytest.approx(np.tile((0, 0, 0, 1), (7, 1)))


@pytest.mark.parametrize("name", ["drive.csv", "drive.tum", "drive.txt"])
def test_a_written_trajectory_is_read_as_the_same(tmp_path: Path, name: str) -> None:
    made = wild()
    write_trajectory(tmp_path / name, made)
    again = read_trajectory(tmp_path / name)
    times_s = np.linspace(made.start_s, made.end_s, 50)
    assert (again.T_map_base(times_s) == made.T_map_base(times_s)).all()
    assert (again.angular_rate_rad_s(times_s) == made.angular_rate_rad_s(times_s)).all()


def test_a_file_of_stamps_since_1970_keeps_its_digits(tmp_path: Path) -> None:
    made = screw()
    later = Trajectory(made.times_s + 1.7e9, made.positions_m, made.quats_xyzw)
    write_trajectory(tmp_path / "later.tum", later)
    read = read_trajectory(tmp_path / "later.tum")
    difference = read.acceleration_m_s2(INNER_S + 1.7e9) - made.acceleration_m_s2(INNER_S)
    assert np.abs(difference).max() < 1e-3


@pytest.mark.parametrize(
    ("name", "text", "field"),
    [
        ("a.csv", "t_s,x_m,y_m,z_m,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n1,0,0,0,0,0,0\n", "a.csv:3"),
        ("a.csv", "t_s,x_m,y_m,z_m,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n", "trajectory"),
        ("a.tum", "# times\n0 0 0 0 0 0 0 1\n\n1 0 0 0 0 0 0 2\n", "a.tum:4"),
        ("a.tum", "1 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n", "trajectory.times_s.1"),
        ("a.tum", "0 0 0 0 0 0 0 1\n1 0 0 nan 0 0 0 1\n", "a.tum:2"),
    ],
)
def test_a_faulty_file_is_refused_with_its_line(
    tmp_path: Path, name: str, text: str, field: str
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InvalidInputError, match=field):
        read_trajectory(tmp_path / name)


@pytest.mark.parametrize("norm", [0.0, 0.98, 1.02, 5.0])
def test_an_orientation_off_unit_norm_is_refused_by_its_row(norm: float) -> None:
    quats = [(0, 0, 0, 1), (0, 0, 0, 0.995), (0, 0, 0, norm)]
    with pytest.raises(InvalidInputError, match=r"quats_xyzw.2.*within 0\.01 of 1"):
        Trajectory([0, 1, 2], np.zeros((3, 3)), quats)


def test_a_time_outside_of_a_trajectory_is_refused() -> None:
    made = screw()
    for time_s in (1.9, 12.1, np.nan):
        with pytest.raises(InvalidInputError, match="2 s to 12 s"):
            made.T_map_base([3.0, time_s])
    assert made.position_m(12.0 + 1e-9) == pytest.approx(made.position_m(12.0))


def test_the_motion_about_a_sample_is_that_of_the_trajectory_and_survives_its_record() -> None:
    made = wild()
    sample_s = made.times_s[3] - 0.2
    motion = made.motion_about(sample_s, -0.1, 1.0)
    times_s = np.linspace(-0.1, 1.0, 50)
    assert motion(times_s) == pytest.approx(made.T_map_base(sample_s + times_s), abs=1e-12)
    again = RigMotion.from_text(motion.text())
    assert again(times_s).tobytes() == motion(times_s).tobytes()
    assert again.text() == motion.text()


def test_a_motion_begins_with_the_velocity_of_the_trajectory_before_it() -> None:
    made = wild()
    motion = made.motion_about(made.start_s, -0.01, 0.0)
    before, start = motion(np.array((-0.01, 0.0)))
    velocity_m_s = made.velocity_m_s([made.start_s])[0]
    assert before[:3, 3] == pytest.approx(start[:3, 3] - 0.01 * velocity_m_s, abs=1e-12)
    turned = Rotation.from_matrix(before[:3, :3].T @ start[:3, :3]).as_rotvec()
    assert turned == pytest.approx(0.01 * made.angular_rate_rad_s([made.start_s])[0], abs=1e-9)


def test_motion_outside_of_its_time_is_refused() -> None:
    made = screw()
    for time_s in (1.9, 11.95, 12.1):
        with pytest.raises(InvalidInputError, match=r"time_s: received .*, expected a time of the"):
            made.motion_about(time_s, 0.0, 0.1)
    motion = made.motion_about(3.0, 0.0, 0.1)
    for beyond_s in (-0.2, 0.3, np.nan):
        with pytest.raises(InvalidInputError, match=r"motion\.time_s"):
            motion(np.array([0.0, beyond_s]))


@pytest.mark.parametrize("change", ["", "}", ',"more":[]}', "null}"])
def test_a_damaged_record_of_a_motion_is_refused(change: str) -> None:
    text = screw().motion_about(3.0, 0.0, 0.1).text()
    damaged = text[:-1] + change if change != "}" else text.replace("[[", "[[[", 1) + change
    with pytest.raises(InvalidInputError, match=r"provenance.motion_json.*the JSON of a motion"):
        RigMotion.from_text(damaged)
