"""Mesh files of many small parts, which were read for minutes."""

from __future__ import annotations

import base64
import json
import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.mesh_formats.mesh_texts import MAX_PARTS
from oaisys_core.procedural.meshes.files import load_mesh

POINTS = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
VERTICES = "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0"
FACET = f"facet normal 0 0 1\nouter loop\n{VERTICES}\nendloop\nendfacet"


def write_stl(folder: Path, count: int) -> Path:
    path = folder / "a.stl"
    path.write_text("".join(f"solid {n}\n{FACET}\nendsolid {n}\n" for n in range(count)))
    return path


def obj_of(line: str, *, with_face: bool) -> Callable[[Path, int], Path]:
    def write(folder: Path, count: int) -> Path:
        face = "\nf 1 2 3\n" if with_face else "\n"
        lines = "".join(line.format(n=n) + face for n in range(count))
        path = folder / "a.obj"
        path.write_text(POINTS + lines + "f 1 2 3\n")
        return path

    return write


def write_gltf(folder: Path, primitives: int, nodes: int = 1) -> Path:
    data = base64.b64encode(np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], np.float32).tobytes())
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 36, "uri": f"data:;base64,{data.decode()}"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}] * primitives}],
        "nodes": [{"mesh": 0}] * nodes,
    }
    path = folder / "a.gltf"
    path.write_text(json.dumps(document))
    return path


WRITERS: dict[str, tuple[Callable[[Path, int], Path], str]] = {
    "solids": (write_stl, "solids"),
    "objects": (obj_of("o {n}", with_face=True), "objects and materials"),
    "materials": (obj_of("usemtl m{n}", with_face=True), "materials"),
    "libraries": (obj_of("mtllib {n}.mtl", with_face=False), "libraries \\(line"),
    "names of libraries": (
        lambda folder, count: obj_of("mtllib a{n} b{n}", with_face=False)(folder, count // 2 + 1),
        "libraries: join",
    ),
    "primitives": (write_gltf, "primitives"),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_files_of_many_parts_are_refused_by_their_number(tmp_path: Path, kind: str) -> None:
    write, what = WRITERS[kind]
    with pytest.raises(InvalidInputError, match=f"at most {MAX_PARTS} .*{what}"):
        load_mesh(write(tmp_path, MAX_PARTS + 1))
    assert len(load_mesh(write(tmp_path, 20)).triangles) >= 1


def test_instances_count_as_parts(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="each instance counts, not 4100"):
        load_mesh(write_gltf(tmp_path, 41, 100))


def test_missing_files_are_one_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        load_mesh(obj_of("mtllib {n}.mtl", with_face=False)(tmp_path, 7))
    (record,) = caplog.records
    shown = "'0.mtl', '1.mtl', '2.mtl', '3.mtl', '4.mtl', … (7), which it refers to, are missing"
    assert shown in record.getMessage()


def test_a_file_is_read_once_under_all_spellings(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    Image.new("RGB", (2, 2), (200, 0, 0)).save(tmp_path / "red.png")
    materials = (f"newmtl m{n}\nKd 1 1 1\nmap_Kd {'./' * n}red.png\n" for n in range(3))
    (tmp_path / "a.mtl").write_text("".join(materials))
    lines = "".join(f"mtllib {'./' * n}a.mtl\nusemtl m{n}\nf 1/1 2/1 3/1\n" for n in range(3))
    (tmp_path / "a.obj").write_text(f"{POINTS}vt 0 0\n{lines}")
    first, *others = load_mesh(tmp_path / "a.obj").materials
    assert first.color_image_srgb is not None
    assert all(each.color_image_srgb is first.color_image_srgb for each in others)
    assert "come again" not in caplog.text
