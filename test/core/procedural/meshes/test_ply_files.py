"""What .ply files say: polygons, and colours of any type of number."""

from __future__ import annotations

import logging
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


ST = "property float s\nproperty float t\n"
WEDGES = "property list uchar float texcoord\n"
SQUARE = ["0 0 0", "1 0 0", "1 1 0", "0 1 0"]
PICTURES = {"red.png": (200, 0, 0), "green.png": (0, 200, 0), "blue.png": (0, 0, 200)}


def textures(folder: Path, *names: str) -> str:
    """Save pictures of one colour and return the lines of a header that name them."""
    for name in names:
        Image.new("RGB", (2, 2), PICTURES[name]).save(folder / name)
    return "".join(f"comment TextureFile {name}\n" for name in names)


def colors_by_triangle(mesh: LoadedMesh) -> list[tuple[int, ...]]:
    assert mesh.material_of is not None
    images = [mesh.materials[index].color_image_srgb for index in mesh.material_of]
    return [() if image is None else tuple(image[0, 0].tolist()) for image in images]


def test_an_image_lies_on_a_concave_face(tmp_path: Path) -> None:
    header = f"{textures(tmp_path, 'red.png')}element vertex 6\n{XYZ}{ST}{FACES}"
    # Texture coordinates that are those in the plane, over 4.
    rows = [f"{line} {float(line[0]) / 4} {float(line[2]) / 4}" for line in ANGLE]
    mesh = load(tmp_path, header, "\n".join([*rows, "6 1 2 3 4 5 0\n"]))
    assert area(mesh) == pytest.approx(7.0)
    assert mesh.uv is not None
    np.testing.assert_array_equal(mesh.uv * 4, mesh.vertices_m[mesh.triangles][..., :2])
    assert colors_by_triangle(mesh) == [(200, 0, 0)] * len(mesh.triangles)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("place", ["face", "vertex"])
def test_each_face_has_the_image_of_its_number(tmp_path: Path, kind: str, place: str) -> None:
    number = "property int texnumber\n"
    header = f"{textures(tmp_path, *PICTURES)}element vertex 12\n{XYZ}{ST}"
    header += number if place == "vertex" else ""
    header += FACES.replace("face 1", "face 3")
    header += f"{WEDGES}{number}" if place == "face" else ""
    of_face, uv = (2, 0, 1), (0, 0, 1, 0, 1, 1, 0, 1)
    rows = [
        (float(x) + 2 * face, float(y), 0.0, *uv[2 * corner : 2 * corner + 2])
        for face in range(3)
        for corner, (x, y, _) in enumerate(line.split() for line in SQUARE)
    ]
    text, body = "", b""
    for index, row in enumerate(rows):
        more = (of_face[index // 4],) if place == "vertex" else ()
        text += " ".join(map(str, (*row, *more))) + "\n"
        body += struct.pack("<5f" + "i" * len(more), *row, *more)
    for face in range(3):
        corners = range(4 * face, 4 * face + 4)
        wedges = (8, *uv, of_face[face]) if place == "face" else ()
        text += " ".join(map(str, (4, *corners, *wedges))) + "\n"
        body += struct.pack("<B4i" + ("B8fi" if wedges else ""), 4, *corners, *wedges)
    mesh = load(tmp_path, header, text if kind == "ascii" else body, kind)
    assert colors_by_triangle(mesh) == [(0, 0, 200)] * 2 + [(200, 0, 0)] * 2 + [(0, 200, 0)] * 2
    assert mesh.uv is not None
    at = mesh.vertices_m[mesh.triangles][..., :2] - [2, 0] * np.repeat([0, 1, 2], 2)[:, None, None]
    np.testing.assert_array_equal(mesh.uv, at)


def wedges(
    folder: Path, files: str, number: str = "", first: str = "", second: str = ""
) -> LoadedMesh:
    """Return a square of two triangles whose corners have coordinates, and the given numbers."""
    header = f"{files}element vertex 4\n{XYZ}{FACES.replace('face 1', 'face 2')}{WEDGES}{number}"
    faces = [f"3 0 1 2 6 0 0 1 0 1 1 {first}", f"3 0 2 3 6 0 0 1 1 0 1 {second}\n"]
    return load(folder, header, "\n".join([*SQUARE, *faces]))


def test_an_image_lies_by_the_coordinates_of_corners(tmp_path: Path) -> None:
    mesh = wedges(tmp_path, textures(tmp_path, "red.png"))
    assert mesh.uv is not None
    np.testing.assert_array_equal(mesh.uv, mesh.vertices_m[mesh.triangles][..., :2])


@pytest.mark.parametrize(
    ("number", "values", "expected"),
    [
        ("", "", "faces with texnumber, as there are 2 of TextureFile"),
        ("property int texnumber\n", "2", "texnumber from 0 to 1, .*, not 2: face 0"),
        ("property int texnumber\n", "-1", "texnumber from 0 to 1, .*, not -1: face 0"),
        ("property float texnumber\n", "0.5", r"texnumber from 0 to 1, .*, not 0\.5: face 0"),
    ],
)
def test_several_images_without_a_number_of_each_face_are_refused(
    tmp_path: Path, number: str, values: str, expected: str
) -> None:
    files = textures(tmp_path, "red.png", "blue.png")
    with pytest.raises(InvalidInputError, match=expected):
        wedges(tmp_path, files, number, values, values)


def test_a_face_whose_corners_have_several_images_is_refused(tmp_path: Path) -> None:
    files = textures(tmp_path, "red.png", "blue.png")
    header = f"{files}element vertex 3\n{XYZ}{ST}property int texnumber\n{FACES}"
    rows = ["0 0 0 0 0 0", "1 0 0 1 0 0", "1 1 0 1 1 1", "3 0 1 2\n"]
    with pytest.raises(InvalidInputError, match="not 0, 1: face 0"):
        load(tmp_path, header, "\n".join(rows))


def test_missing_images_are_told_without_a_traceback(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    colors = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    header = f"comment TextureFile gone.png\nelement vertex 3\n{XYZ}{ST}{colors}{FACES}"
    rows = [f"{line} 0 0 7 8 9" for line in SQUARE[:3]]
    with caplog.at_level(logging.DEBUG):
        mesh = load(tmp_path, header, "\n".join([*rows, "3 0 1 2\n"]))
    (record,) = (each for each in caplog.records if each.levelno >= logging.WARNING)
    assert "'gone.png', which it refers to, is missing" in record.getMessage()
    assert not any(each.exc_info for each in caplog.records)
    assert mesh.vertex_colors_srgb is not None
    assert mesh.vertex_colors_srgb[0].tolist() == [7, 8, 9]
    files = textures(tmp_path, "red.png") + "comment TextureFile gone.png\n"
    mesh = wedges(tmp_path, files, "property int texnumber\n", "1", "0")
    assert colors_by_triangle(mesh) == [(), (200, 0, 0)]
    assert mesh.materials[1].color_srgb == (0.5, 0.5, 0.5)


def test_an_image_without_coordinates_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    header = f"{textures(tmp_path, 'red.png')}element vertex 3\n{XYZ}{FACES}"
    with caplog.at_level(logging.WARNING):
        load(tmp_path, header, "\n".join([*SQUARE[:3], "3 0 1 2\n"]))
    assert "its TextureFile is not used, as it has no texture coordinates" in caplog.text


def test_an_image_that_cannot_be_decoded_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "bad.png").write_bytes(b"\x89PNG\r\n\x1a\nno more")
    with pytest.raises(InvalidInputError, match=r"bad\.png.*a mesh's texture that can be read"):
        wedges(tmp_path, "comment TextureFile bad.png\n")


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


def test_a_list_as_a_coordinate_is_refused_in_words(tmp_path: Path) -> None:
    """NumPy said "format number 2 of ... is not recognized"."""
    header = XYZ.replace("property float x", "property list uchar float x")
    body = "1 0 0 0\n1 1 0 0\n1 0 1 0\n3 0 1 2\n"
    with pytest.raises(InvalidInputError, match="one number as x, not a list"):
        load(tmp_path, f"element vertex 3\n{header}{FACES}", body)


@pytest.mark.parametrize("count", ["9" * 5000, "--5", "1_0"])
def test_a_count_that_is_no_number_is_refused(tmp_path: Path, count: str) -> None:
    with pytest.raises(InvalidInputError, match="a header that names each element with its number"):
        load(tmp_path, f"element vertex {count}\n{XYZ}{FACES}", "0 0 0\n")
