"""What stands in .mtl files, by the MTL specification: white space, names, numbers and options."""

from __future__ import annotations

import logging
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.meshes.files import load_mesh
from oaisys_core.procedural.meshes.loaded import LoadedMesh

VERTICES = b"v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\n"
HEAD = VERTICES + b"vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
USE = b"mtllib a.mtl\nusemtl m\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
NO_UV = b"mtllib a.mtl\nusemtl m\nf 1 2 3\nf 1 3 4\n"


def load(folder: Path, mtl: bytes, faces: bytes = USE) -> LoadedMesh:
    (folder / "a.mtl").write_bytes(mtl)
    (folder / "a.obj").write_bytes(HEAD + faces)
    return load_mesh(folder / "a.obj", field="stage.mesh.file")


def save(path: Path, color: tuple[int, int, int]) -> None:
    data = path.parent / "any.png"
    Image.new("RGB", (4, 4), color).save(data)
    data.rename(path)


@pytest.mark.parametrize(
    "mtl",
    [
        b"newmtl m\nKd\t0.8 0.1 0.2\n",
        b"newmtl\tm\nKd\t0.8\t0.1\t0.2\n",
        b"\tnewmtl  m\r\n\t Kd \t 0.8  0.1\t0.2 # red\r\n",
        b"\xef\xbb\xbfnewmtl m\nKd 0.8 0.1 0.2\n",
        b"newmtl m\nKd 0.8 \\\n0.1 0.2\n",
        b"newmtl m\nKd 0.8 \\\r\n\t0.1 0.2\r\n",
        b"newmtl m\rKd 0.8 0.1 0.2\r",
        b"newmtl m\nKD 0.8 0.1 0.2\n",
    ],
)
def test_white_space_marks_and_joined_lines_change_no_colour(tmp_path: Path, mtl: bytes) -> None:
    for faces in (USE, NO_UV):
        (material,) = load(tmp_path, mtl, faces).materials
        assert material.color_srgb == (0.8, 0.1, 0.2)


def test_one_number_is_a_grey(tmp_path: Path) -> None:
    assert load(tmp_path, b"newmtl m\nKd 0.25\n").materials[0].color_srgb == (0.25, 0.25, 0.25)


@pytest.mark.parametrize("line", [b"map_Kd\tmy  tex.png", b"map_Kd -s 1 1 1\t-o 0\tmy  tex.png "])
def test_names_of_pictures_keep_their_spaces(tmp_path: Path, line: bytes) -> None:
    save(tmp_path / "my  tex.png", (10, 200, 30))
    save(tmp_path / "tex.png", (1, 1, 1))
    image = load(tmp_path, b"newmtl m\n" + line + b"\n").color_image_srgb
    assert image is not None
    assert image[0, 0].tolist() == [10, 200, 30]


@pytest.mark.parametrize("encoding", ["gbk", "latin-1", "utf-8"])
def test_names_in_any_encoding_stay_apart(tmp_path: Path, encoding: str) -> None:
    first, second = ("红", "蓝") if encoding == "gbk" else ("Mäuer", "Möuer")
    a, b = first.encode(encoding), second.encode(encoding)
    (tmp_path / os.fsdecode(b + b".mtl")).write_bytes(b"newmtl " + b + b"\nmap_Kd " + a + b".png\n")
    save(tmp_path / os.fsdecode(a + b".png"), (10, 20, 30))
    mtl = b"newmtl " + a + b"\nKd 1 0 0\n"
    faces = b"mtllib a.mtl\nmtllib " + b + b".mtl\n"
    faces += b"o " + a + b"\nusemtl " + a + b"\nf 1/1 2/2 3/3\n"
    faces += b"o " + b + b"\nusemtl " + b + b"\nf 1/1 3/3 4/4\n"
    mesh = load(tmp_path, mtl, faces)
    red, picture = mesh.materials
    assert red.color_srgb == (1.0, 0.0, 0.0)
    assert red.color_image_srgb is None
    assert picture.color_image_srgb is not None
    assert picture.color_image_srgb[0, 0].tolist() == [10, 20, 30]
    # What users see, type and store.
    assert all(each.name.isprintable() for each in mesh.materials)
    if encoding == "utf-8":
        assert (red.name, picture.name) == (first, second)
    path = tmp_path / "a.obj"
    assert [each.color_srgb for each in load_mesh(path, red.name).materials] == [(1, 0, 0)]
    with pytest.raises(InvalidInputError) as error:
        load_mesh(path, "gone")
    assert str(error.value).isprintable()
    assert red.name in str(error.value)


def test_messages_about_names_in_other_encodings_can_be_shown(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    faces = USE.replace(b"usemtl m", b"mtllib \xe4.mtl\nusemtl \xfc")
    with caplog.at_level(logging.WARNING):
        load(tmp_path, b"newmtl m\nmap_Kd gone.png\n", faces)
    assert "\\udce4.mtl" in caplog.text
    assert "so they are grey: \\xfc" in caplog.text
    assert caplog.text.replace("\n", "").isprintable()
    (tmp_path / os.fsdecode(b"\xe4.png")).write_bytes(b"no picture")
    with pytest.raises(InvalidInputError) as error:
        load(tmp_path, b"newmtl m\nmap_Kd \xe4.png\n")
    assert str(error.value).isprintable()


@pytest.mark.parametrize("faces", [USE, NO_UV])
@pytest.mark.parametrize(
    "line",
    [
        *(b"Kd 0,1 0,2 0,3", b"Kd spectral x.rfl 1", b"Kd xyz 0.1 0.2 0.3", b"Kd 204 26 51", b"Kd"),
        *(
            b"Kd 0_1 0 0",
            b"d 0_1",
            b"Kd 0.1 0.2",
            b"Kd 0.1 0.2 0.3 0.4",
            b"Kd 0.1 0.2 nan",
            b"Kd -1 0 0",
            b"Kd 0.1 0.2 x",
        ),
        *(b"d 0,5", b"d 255", b"d", b"d -1", b"d 0.5 0.5", b"Tr 0,5", b"Tr 100", b"Tr x"),
        *(b"map_Kd -s 2,5 1 1 a.png", b"map_Kd -o x a.png", b"map_Kd -s nan a.png"),
        *(b"map_Kd -clamp yes a.png", b"map_d -imfchan z a.png", b"map_Kd -o a.png"),
    ],
)
def test_what_is_not_understood_is_refused_by_file_line_and_value(
    tmp_path: Path, line: bytes, faces: bytes
) -> None:
    save(tmp_path / "a.png", (1, 2, 3))
    key, _, value = line.partition(b" ")
    with pytest.raises(InvalidInputError, match=r": a\.mtl, line 3") as error:
        load(tmp_path, b"# colours\nnewmtl m\n" + line + b"\n", faces)
    text = str(error.value)
    assert error.value.field == "stage.mesh.file"
    assert (value.split()[0] if key.startswith(b"map") else key).decode() in text
    assert key.startswith(b"map") or f"not {value.decode()!r}" in text


def test_what_no_face_uses_is_not_judged(tmp_path: Path) -> None:
    mesh = load(tmp_path, b"newmtl m\nKd 1 0 0\nnewmtl other\nKd 204 26 51\n")
    assert mesh.materials[0].color_srgb == (1, 0, 0)


def test_numbers_that_are_rounded_up_are_one(tmp_path: Path) -> None:
    (material,) = load(tmp_path, b"newmtl m\nKd 1.0001 0 0\nd 1.0001\n").materials
    assert material.color_srgb == (1, 0, 0)


@pytest.mark.parametrize("line", [b"d 0", b"Tr 1", b"d 0.3", b"d -halo 0.0"])
@pytest.mark.parametrize("faces", [USE, NO_UV])
def test_what_is_see_through_everywhere_is_opaque_and_named(
    tmp_path: Path, line: bytes, faces: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        (material,) = load(tmp_path, b"newmtl m\nKd 1 0 0\n" + line + b"\n", faces).materials
    assert material.opacity is None
    assert "material 'm': is see-through" in caplog.text


@pytest.mark.parametrize(
    ("channel", "holes"), [("r", [1, 0, 1]), ("g", [0, 1, 1]), ("m", [0, 0, 1]), ("l", [1, 1, 1])]
)
def test_a_map_says_which_channel_cuts_out(tmp_path: Path, channel: str, holes: list[int]) -> None:
    pixels = [[(0, 255, 0, 255), (255, 0, 0, 255), (0, 0, 0, 0), (255, 255, 255, 255)]]
    Image.fromarray(np.array(pixels, np.uint8)).save(tmp_path / "a.png")
    (material,) = load(tmp_path, f"newmtl m\nmap_d -imfchan {channel} a.png\n".encode()).materials
    assert material.opacity is not None
    assert (material.opacity < material.cutoff).tolist() == [[*map(bool, holes), False]]


@pytest.mark.parametrize(
    ("mtl", "told"),
    [
        (b"newmtl m\nmap_Kd -mm 0.2 0.5 a.png\n", "-mm is not read: a.mtl, line 2"),
        (b"newmtl m\nmap_Kd -t 1 1 1 a.png\n", "-t is not read: a.mtl, line 2"),
        (b"newmtl m\nmap_Kd -foo 1 a.png\n", "-foo is not read: a.mtl, line 2"),
        (b"newmtl m\nmap_Kd a.png\nmap_d -s 2 2 a.png\n", "map_d lies as map_Kd does: a.mtl, line"),
        (b"newmtl m\ndecal a.png\nKs 1 1 1\n", "a.mtl: lines that are not read: decal"),
        (b"newmtl m\nKd 1 0 0\nnewmtl m\nKd 0 1 0\n", "of which the last counts: m"),
    ],
)
def test_what_is_left_out_is_named(
    tmp_path: Path, mtl: bytes, told: str, caplog: pytest.LogCaptureFixture
) -> None:
    save(tmp_path / "a.png", (1, 2, 3))
    with caplog.at_level(logging.WARNING):
        load(tmp_path, mtl)
    assert told in caplog.text
    caplog.clear()
    plain = b"newmtl m\nKd 1 1 1\nKs 9 9 9\nillum 2\nmap_Kd -bm 2 -mm 0 1 -t 0 0 0 a.png\n"
    with caplog.at_level(logging.WARNING):
        load(tmp_path, plain)
    assert not caplog.records


@pytest.mark.parametrize("encoding", ["utf-16", "utf-32"])
def test_utf_16_is_refused(tmp_path: Path, encoding: str) -> None:
    with pytest.raises(InvalidInputError, match=rf"UTF-8, not {encoding.upper()}: a\.mtl"):
        load(tmp_path, "newmtl m\nKd 1 0 0\n".encode(encoding))


def test_a_material_is_one_on_faces_without_coordinates(tmp_path: Path) -> None:
    faces = b"mtllib a.mtl\nusemtl m\no a\nf 1 2 3\no b\nf 1 3 4\n"
    assert len(load(tmp_path, b"newmtl m\nKd 1 0 0\n", faces).materials) == 1
