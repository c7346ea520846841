"""What .obj files say, by the format's specification, and what is refused by its line."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.meshes.files import load_mesh
from oaisys_core.procedural.meshes.loaded import LoadedMesh

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def load(folder: Path, text: str, name: str | None = None) -> LoadedMesh:
    path = folder / "a.obj"
    path.write_bytes(text.encode())
    return load_mesh(path, name, field="stage.mesh.file")


def area(mesh: LoadedMesh) -> float:
    a, b, c = (mesh.vertices_m[mesh.triangles[:, corner]].astype(float) for corner in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_concave_faces_leave_their_notch_open(tmp_path: Path) -> None:
    angle = "v 0 0 0\nv 4 0 0\nv 4 1 0\nv 1 1 0\nv 1 4 0\nv 0 4 0\n"
    assert area(load(tmp_path, angle + "f 2 3 4 5 6 1\n")) == pytest.approx(7.0)
    arrow = "v 4 0 0\nv 1 1 0\nv 0 4 0\nv 0 0 0\n"
    assert area(load(tmp_path, arrow + "f 1 2 3 4\nf -4 -3 -2 -1\n")) == pytest.approx(8.0)


def test_texture_coordinates_of_a_concave_face_stay_at_their_corners(tmp_path: Path) -> None:
    Image.new("RGB", (2, 2)).save(tmp_path / "a.png")
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd a.png\n")
    points = [(4, 0), (1, 1), (0, 4), (0, 0)]
    text = "mtllib a.mtl\nusemtl m\n" + "".join(f"v {x} {y} 0\nvt {x} {y}\n" for x, y in points)
    mesh = load(tmp_path, text + "f 1/1 2/2 3/3 4/4\n")
    assert mesh.uv is not None
    np.testing.assert_array_equal(mesh.uv, mesh.vertices_m[mesh.triangles][..., :2])


TWO = "f 1 2 3\nf 1 3 4\n"
SPELLINGS = {
    "a tab behind f": SQUARE + "f 1 2 3\nf\t1 3 4\n",
    "an indented f": SQUARE + "f 1 2 3\n  f 1 3 4\n",
    "a tab behind v": SQUARE.replace("v 1 1", "v\t1 1") + TWO,
    "tabs everywhere": (SQUARE + TWO).replace(" ", "\t"),
    "everything indented": "".join(f" \t{line}\n" for line in (SQUARE + TWO).splitlines()),
    "a joined line": SQUARE + "f 1 2 \\\n 3\nf 1\\\n3 4\n",
    "a joined line of Windows": (SQUARE + "f 1 2 \\\n3 4\n").replace("\n", "\r\n"),
    "line ends of old Macs": (SQUARE + TWO).replace("\n", "\r"),
    "comments behind numbers": (SQUARE + TWO).replace("\n", " # f 9\n"),
    "a comment that ends with a folder": "# C:\\a\\\n" + SQUARE + TWO,
    "a byte order mark": "\ufeff" + SQUARE + TWO,
    "an older name of f": SQUARE + "fo 1 2 3 4\n",
    "no line end": SQUARE + "f 1 2 3 4",
    "several kinds of corners": "vt 0 0\nvn 0 0 1\n" + SQUARE + "f 1//1 2//1 3//1\nf 1/1 3/1 4/1\n",
    "corners without what follows": "vt 0 0\n" + SQUARE + "f 1/1/ 2/1/ 3/1/\nf 1// 3// 4//\n",
}


@pytest.mark.parametrize("what", SPELLINGS)
def test_white_space_comments_and_joined_lines_lose_nothing(tmp_path: Path, what: str) -> None:
    mesh = load(tmp_path, SPELLINGS[what])
    assert len(mesh.triangles) == 2
    assert area(mesh) == pytest.approx(1.0)
    assert mesh.vertices_m.max(axis=0).tolist() == [1, 1, 0]


def test_negative_indices_count_from_the_face_not_from_the_end(tmp_path: Path) -> None:
    text = "".join(
        f"v 0 0 {z}\nvt 0 0\nv 1 0 {z}\nvt 1 0\nv 0 1 {z}\nvt 0 1\nf -3/-3 -2/-2 -1/-1\n"
        for z in (0, 5)
    )
    mesh = load(tmp_path, text)
    assert sorted(mesh.vertices_m[mesh.triangles][:, 0, 2].tolist()) == [0, 5]


def test_an_image_stays_where_only_some_faces_have_coordinates(tmp_path: Path) -> None:
    Image.new("RGB", (2, 2), (200, 0, 0)).save(tmp_path / "a.png")
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 1 1 1\nmap_Kd a.png\n")
    text = "mtllib a.mtl\nvt 0 0\nvt 1 0\nvt 1 1\n" + SQUARE
    mesh = load(tmp_path, text + "usemtl m\nf 1/1 2/2 3/3\nf 1 3 4\n")
    assert [m.color_image_srgb is not None for m in mesh.materials] == [True, False]
    assert mesh.material_of is not None
    assert mesh.material_of.tolist() == [0, 1]


INDICES = r"indices of v from 1 to 4, or from -1 to -4, not {}: line 5"
REFUSED = {
    "index 0": ("f 0 1 2\n", INDICES.format(0)),
    "an index too large": ("f 1 2 9\n", INDICES.format(9)),
    "an index too negative": ("f -5 1 2\n", INDICES.format(-5)),
    "texture coordinates that are not there": ("f 1/1 2/1 3/1\n", "indices of vt from 1 to 0"),
    "an index beyond 64 bits": ("f 1 2 " + "9" * 30 + "\n", "whole numbers v, v/vt.*line 5"),
    "words as indices": ("f 1 2 x\n", "whole numbers v, v/vt.*'f 1 2 x': line 5"),
    "four indices of a corner": ("f 1/1/1/1 2 3\n", "whole numbers v, v/vt.*line 5"),
    "coordinates at some corners": ("vt 0 0\nf 1/1 2 3\n", "at all corners or at none.*line 6"),
    "two corners": ("f 1 2\n", "three or more corners, not 'f 1 2': line 5"),
    "two coordinates": ("v 0 0\nf 1 2 3\n", "three coordinates.*'v 0 0': line 5"),
    "a decimal comma": ("v 0,5 0 0\nf 1 2 3\n", "decimal points, not 'v 0,5 0 0': line 5"),
    "joined digits": ("v 1_0 0 0\nf 1 2 3\n", "decimal points, not 'v 1_0 0 0': line 5"),
    "joined digits of an index": ("f 1 2 0_3\n", "whole numbers v, v/vt.*'f 1 2 0_3': line 5"),
    "joined digits of a corner": ("f 1//0_1 2 3\n", "whole numbers v, v/vt.*line 5"),
    "free-form surfaces": ("surf 0 1 0 1 1 2 3 4\nf 1 2 3\n", "free-form surfaces: line 5"),
    "another file": ("call b.obj\nf 1 2 3\n", "no calls of other files: line 5"),
    "a face that crosses itself": ("f 1 3 2 4\n", "does not cross itself: line 5"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_against_the_specification_is_refused_by_its_line(
    tmp_path: Path, what: str
) -> None:
    text, expected = REFUSED[what]
    with pytest.raises(InvalidInputError, match=rf"stage.mesh.file.*a\.obj.*{expected}"):
        load(tmp_path, SQUARE + text)


def test_unknown_statements_are_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        load(tmp_path, SQUARE + "s 1\ng wall\nusemap wood\nF 1 3 4\nf 1 2 3\n")
    assert "lines that begin with 'usemap', 'F' are not read" in caplog.text
    assert "'g'" not in caplog.text


def test_colours_of_some_vertices_or_beyond_one_are_refused(tmp_path: Path) -> None:
    red = "v 0 0 0 1 0 0\nv 1 0 0 1 0 0\n"
    with pytest.raises(InvalidInputError, match=r"colours at all vertices.*line 3"):
        load(tmp_path, red + "v 0 1 0\nf 1 2 3\n")
    with pytest.raises(InvalidInputError, match=r"from 0 to 1, not \(255, 0, 0\): line 3"):
        load(tmp_path, red + "v 0 1 0 255 0 0\nf 1 2 3\n")
    mesh = load(
        tmp_path, red + "v 0 1 0 0 0.5 1\n" + "o plain\n" + SQUARE + "f 4 5 6\no b\nf 1 2 3\n", "b"
    )
    assert mesh.vertex_colors_srgb is not None
    assert mesh.vertex_colors_srgb.tolist() == [[255, 0, 0], [255, 0, 0], [0, 128, 255]]


def test_seams_of_normals_keep_their_vertices(tmp_path: Path) -> None:
    text = SQUARE + "vn 0 0 1\nvn 1 0 0\nf 1//1 2//1 3//1\nf 1//2 3//2 4//2\n"
    assert len(load(tmp_path, text).vertices_m) == 6
