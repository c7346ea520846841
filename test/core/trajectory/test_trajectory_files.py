"""Trajectories as others write them, against evo's readers and numbers by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface

from oaisys_core.errors import InvalidInputError
from oaisys_core.output.poses import read_poses
from oaisys_core.trajectory.files import read_trajectory
from oaisys_core.trajectory.planning import read_waypoints

HEAD = "t_s,x_m,y_m,z_m,qx,qy,qz,qw"
SPACED = HEAD.replace(",", " , ")
EUROC_HEAD = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], "
    "q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_RS_R_x [m s^-1]"
)
STAMP_NS = 1403636580838555648


@pytest.mark.parametrize("comma", [",", ", "])
def test_the_ground_truth_of_euroc_is_read_as_evo_reads_it(tmp_path: Path, comma: str) -> None:
    rows = [
        (STAMP_NS, 4.688, -1.786, 0.783, 0.8, 0.0, 0.6, 0.0, 9),
        (STAMP_NS + 5_000_000, 4.7, -1.7, 0.8, 0.6, 0.0, 0.0, 0.8, 9),
        (STAMP_NS + 10_000_000, 4.8, -1.6, 0.9, 1.0, 0.0, 0.0, 0.0, 9),
    ]
    path = tmp_path / "data.csv"
    path.write_text("\r\n".join([EUROC_HEAD, *(comma.join(map(str, row)) for row in rows), ""]))
    ours, theirs = read_trajectory(path), file_interface.read_euroc_csv_trajectory(str(path))
    assert ours.times_s == pytest.approx(theirs.timestamps, abs=1e-6, rel=0)
    assert ours.positions_m == pytest.approx(theirs.positions_xyz)
    wxyz = np.roll(ours.quats_xyzw, 1, axis=1)
    dots = (wxyz * theirs.orientations_quat_wxyz).sum(axis=1)
    assert np.abs(dots) == pytest.approx(1)
    assert ours.quats_xyzw[0] == pytest.approx((0, 0.6, 0, 0.8))


def test_orientations_typed_by_hand_are_normalised_and_others_refused(tmp_path: Path) -> None:
    rounded = "0,0.38,0,0.93"
    path = tmp_path / "a.csv"
    path.write_text(f"{HEAD}\n0,1,2,3,{rounded}\n1,4,5,6,{rounded}\n")
    trajectory = read_trajectory(path)
    assert np.linalg.norm(trajectory.pose(0.5).quat_xyzw) == pytest.approx(1, abs=1e-12)
    for bad in ("0,0,0,1.02", "0,0,0,0"):
        path.write_text(f"{HEAD}\n0,1,2,3,{rounded}\n1,4,5,6,{bad}\n")
        with pytest.raises(InvalidInputError, match=r"a.csv:3.*within 0.01 of 1"):
            read_trajectory(path)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", f"\ufeff{HEAD}\r\n0,1,2,3,0,0,0,1\r\n1,4,5,6,0,0,0,1\r\n"),
        ("a.csv", f"# a\n{SPACED}\n0, 1, 2, 3, 0, 0, 0, 1\n# b\n\n1, 4, 5, 6, 0, 0, 0, 1\n"),
        ("a.TUM", "\ufeff0 1 2 3 0 0 0 1\r\n1 4 5 6 0 0 0 1 # end\r\n"),
        ("a.txt", "\ufeff# a\n0,1,2,3,0,0,0,1\n\n1,4,5,6,0,0,0,1\n"),
    ],
)
def test_marks_line_ends_spaces_and_comments_do_not_count(
    tmp_path: Path, name: str, text: str
) -> None:
    path = tmp_path / name
    path.write_bytes(text.encode())
    read = read_trajectory(path)
    assert read.times_s.tolist() == [0, 1]
    assert read.positions_m.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_a_stamp_that_occurs_twice_is_kept_once_and_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.tum"
    rows = ["0 0", "1 1", "1 9", "2 2", "0 9"]
    path.write_text("\n".join(f"{row} 0 0 0 0 0 1" for row in rows))
    assert read_trajectory(path).positions_m[:, 0].tolist() == [0, 1, 2]
    assert "2 rows have the stamp of an earlier row, the first of them 3 with 1.0 s" in caplog.text


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        (
            "a.csv",
            f"# a\n\n{HEAD}\n0,0,0,0,0,0,0,1\n1,0,0,x,0,0,0,1\n",
            r"a\.csv:5.*a number in the column z_m",
        ),
        ("a.csv", f"{EUROC_HEAD}\n1.5e9,0,0,0,1,0,0,0\n", r"a\.csv:2.*nanoseconds"),
        ("a.csv", f"{EUROC_HEAD}\n{'9' * 400},0,0,0,1,0,0,0\n", r"a\.csv:2.*nanoseconds"),
        ("a.csv", f"{EUROC_HEAD}\n{'9' * 5000},0,0,0,1,0,0,0\n", r"a\.csv:2.*nanoseconds"),
        ("a.csv", f"{EUROC_HEAD}\n1,0,0,0,1,0,0\n", r"a\.csv:2"),
        ("a.csv", "#timestamp, p_x, p_y, p_z\n1,0,0,0\n", "EuRoC's columns"),
        ("a.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "KITTI"),
        ("a.bag", "#ROSBAG V2.0\n", "ROS 1.*evo_traj bag "),
        ("a.db3", "SQLite format 3", "SQLite.*evo_traj bag2 "),
    ],
)
def test_what_is_not_read_is_named(tmp_path: Path, name: str, text: str, told: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InvalidInputError, match=told):
        read_trajectory(path)


def test_poses_and_waypoints_allow_the_same_and_count_all_lines(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    text = "\ufeff# a\r\nx_m, y_m, z_m, qx, qy, qz, qw\r\n\r\n1, 2, 3, 0, 0, 0, 1\r\n"
    path.write_bytes(text.encode())
    assert [pose.position_m for pose in read_poses(path)] == [(1, 2, 3)]
    assert read_waypoints(path).tolist() == [[1, 2, 3]]
    path.write_bytes((text + "1, no, 3, 0, 0, 0, 1\r\n").encode())
    for read in (read_poses, read_waypoints):
        with pytest.raises(InvalidInputError, match=r"a\.csv:5"):
            read(path)
