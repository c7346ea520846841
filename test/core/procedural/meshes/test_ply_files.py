"""What .ply files say: polygons, and colours of any type of number."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.meshes.files import load_mesh
from oaisys_core.procedural.meshes.loaded import LoadedMesh

XYZ = "property float x\nproperty float y\nproperty float z\n"
FACES = "element face 1\nproperty list uchar int vertex_indices\n"
ANGLE = ["0 0 0", "4 0 0", "4 1 0", "1 1 0", "1 4 0", "0 4 0"]


def load(folder: Path, header: str, body: str | bytes, kind: str = "ascii") -> LoadedMesh:
    path = folder / "a.ply"
    data = body if isinstance(body, bytes) else body.encode()
    path.write_bytes(f"ply\nformat {kind} 1.0\n{header}end_header\n".encode() + data)
    return load_mesh(path, field="stage.mesh.file")


def area(mesh: LoadedMesh) -> float:
    a, b, c = (mesh.vertices_m[mesh.triangles[:, corner]].astype(float) for corner in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_concave_faces_leave_their_notch_open(tmp_path: Path) -> None:
    header = f"element vertex 6\n{XYZ}{FACES}"
    mesh = load(tmp_path, header, "\n".join([*ANGLE, "6 1 2 3 4 5 0\n"]))
    assert area(mesh) == pytest.approx(7.0)
    points = np.array([line.split() for line in ANGLE], "<f4").tobytes()
    body = points + struct.pack("<B6i", 6, 1, 2, 3, 4, 5, 0)
    mesh = load(tmp_path, header, body, "binary_little_endian")
    assert area(mesh) == pytest.approx(7.0)


def test_concave_faces_among_others_are_triangulated(tmp_path: Path) -> None:
    header = f"element vertex 6\n{XYZ}{FACES.replace('face 1', 'face 3')}"
    header += "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    faces = ["3 0 1 3 9 9 9", "5 1 2 3 4 0 9 9 9", "3 3 4 5 50 50 50"]
    mesh = load(tmp_path, header, "\n".join([*ANGLE, *faces]))
    assert len(mesh.triangles) == 5
    assert area(mesh) == pytest.approx(2.0 + 5.0 + 1.5)
    assert mesh.vertex_colors_srgb is not None
    red = mesh.vertex_colors_srgb[:, 0].tolist()
    assert red[:3] + red[5:] == [9, 9, 9, 50]
    assert all(9 < each < 50 for each in red[3:5]), "the means of their faces"


def test_a_face_that_cannot_be_triangulated_is_named(tmp_path: Path) -> None:
    header = f"element vertex 6\n{XYZ}{FACES.replace('face 1', 'face 2')}"
    with pytest.raises(InvalidInputError, match="cross itself: face 1"):
        load(tmp_path, header, "\n".join([*ANGLE, "3 0 1 2", "4 0 5 1 4\n"]))
    with pytest.raises(InvalidInputError, match="three or more corners: face 0"):
        load(tmp_path, header, "\n".join([*ANGLE, "2 0 1", "3 0 1 2\n"]))


def test_an_image_on_a_concave_face_is_refused(tmp_path: Path) -> None:
    Image.new("RGB", (2, 2)).save(tmp_path / "a.png")
    header = (
        f"comment TextureFile a.png\nelement vertex 6\n{XYZ}property float s\nproperty float t\n"
    )
    rows = [f"{line} 0 0" for line in ANGLE]
    with pytest.raises(InvalidInputError, match="convex faces: face 0 is not"):
        load(tmp_path, header + FACES, "\n".join([*rows, "5 1 2 3 4 0\n"]))
    mesh = load(tmp_path, header + FACES, "\n".join([*rows, "4 0 1 3 5\n"]))
    assert mesh.color_image_srgb is not None


def test_lists_of_several_lengths_whose_total_fits_are_refused(tmp_path: Path) -> None:
    header = f"element vertex 6\n{XYZ}{FACES.replace('face 1', 'face 3')}"
    points = np.array([line.split() for line in ANGLE], "<f4").tobytes()
    body = points + struct.pack("<B4iB3iB5i", 4, 0, 1, 2, 3, 3, 0, 1, 2, 5, 0, 1, 2, 3, 4)
    with pytest.raises(InvalidInputError, match="equally many corners"):
        load(tmp_path, header, body, "binary_little_endian")


def colored(folder: Path, kind: str, values: str, names: str = "red green blue") -> LoadedMesh:
    header = f"element vertex 3\n{XYZ}"
    header += "".join(f"property {kind} {name}\n" for name in names.split())
    rows = [f"{xyz} {color}" for xyz, color in zip(ANGLE[:3], values.split(", "), strict=True)]
    return load(folder, header + FACES, "\n".join([*rows, "3 0 1 2\n"]))


COLORS = {
    "uchar": "255 0 0, 0 128 0, 0 0 1",
    "ushort": "65535 0 0, 0 32896 0, 0 0 257",
    "float": "1 0 0, 0 0.502 0, 0 0 0.004",
    "double": "1 0 0, 0 0.502 0, 0 0 0.004",
    "int": "255 0 0, 0 128 0, 0 0 1",
    "uint": "255 0 0, 0 128 0, 0 0 1",
    "short": "255 0 0, 0 128 0, 0 0 1",
}


@pytest.mark.parametrize("kind", COLORS)
def test_colours_are_scaled_by_their_type(tmp_path: Path, kind: str) -> None:
    mesh = colored(tmp_path, kind, COLORS[kind])
    assert mesh.vertex_colors_srgb is not None
    assert mesh.vertex_colors_srgb.tolist() == [[255, 0, 0], [0, 128, 0], [0, 0, 1]]


def test_diffuse_colours_and_those_beside_coordinates_are_read(tmp_path: Path) -> None:
    names = "diffuse_red diffuse_green diffuse_blue"
    mesh = colored(tmp_path, "uchar", COLORS["uchar"], names)
    assert mesh.vertex_colors_srgb is not None
    assert mesh.vertex_colors_srgb.tolist() == [[255, 0, 0], [0, 128, 0], [0, 0, 1]]
    values = "255 0 0 5 5, 0 128 0 5 6, 0 0 1 7 5"
    mesh = colored(tmp_path, "uchar", values, "red green blue s t")
    assert mesh.vertex_colors_srgb is not None
    assert mesh.vertex_colors_srgb.tolist() == [[255, 0, 0], [0, 128, 0], [0, 0, 1]]


@pytest.mark.parametrize(
    ("kind", "values", "expected"),
    [
        ("int", "0 300 0, 0 0 0, 0 0 0", "int32 from 0 to 255, not 300"),
        ("short", "0 -1 0, 0 0 0, 0 0 0", "int16 from 0 to 255, not -1"),
        ("float", "200 0 0, 0 0 0, 0 0 0", "float32 from 0 to 1, not 200"),
        ("float", "nan 0 0, 0 0 0, 0 0 0", "float32 from 0 to 1, not nan"),
        ("ushort", "200 0 0, 0 0 0, 0 0 0", "up to 65535, or of uchar: these are at most 200"),
        (
            "uchar",
            "0 300 0, 0 0 0, 0 0 0",
            "whole numbers from 0 to 255 in vertex, not 300: line 1",
        ),
        ("uchar", "0 0.5 0, 0 0 0, 0 0 0", "whole numbers from 0 to 255 in vertex, not 0.5: line"),
    ],
)
def test_colours_that_may_mean_something_else_are_refused(
    tmp_path: Path, kind: str, values: str, expected: str
) -> None:
    with pytest.raises(InvalidInputError, match=f"stage.mesh.file.*{expected}"):
        colored(tmp_path, kind, values)


def test_strips_beside_faces_are_refused(tmp_path: Path) -> None:
    header = (
        f"element vertex 6\n{XYZ}{FACES}element tristrips 1\nproperty list int int vertex_indices\n"
    )
    with pytest.raises(InvalidInputError, match="tristrips"):
        load(tmp_path, header, "\n".join([*ANGLE, "3 0 1 2", "4 2 3 4 5\n"]))
