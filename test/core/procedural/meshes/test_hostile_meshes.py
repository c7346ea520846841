"""Mesh files that refer to files elsewhere, or announce more than they contain."""

from __future__ import annotations

import base64
import json
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.path_fields import AssetRoots, confine_paths
from oaisys_core.output.images import encode_image
from oaisys_core.procedural.meshes.files import load_mesh

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n"


@pytest.fixture
def top(tmp_path: Path) -> Path:
    for name in ("root", "outside"):
        (tmp_path / name).mkdir()
        Image.new("RGB", (2, 2), (9, 8, 7)).save(tmp_path / name / "secret.png")
        (tmp_path / name / "secret.mtl").write_text("newmtl m\nmap_Kd secret.png\n")
        (tmp_path / name / "secret.bin").write_bytes(np.zeros(100, np.float32).tobytes())
    (tmp_path / "root" / "link.png").symlink_to(tmp_path / "outside" / "secret.png")
    return tmp_path


def obj(material: str = "map_Kd secret.png", library: str = "m.mtl") -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / "m.mtl").write_text(f"newmtl m\n{material}\n")
        (folder / "a.obj").write_text(f"mtllib {library}\n{TRIANGLE}")
        return folder / "a.obj"

    return write


def gltf(
    image: str | None = None, buffer: str | None = None, **more: Any
) -> Callable[[Path], Path]:
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], np.float32).tobytes()
    uv = np.zeros((3, 2), np.float32).tobytes()
    own = "data:application/octet-stream;base64," + base64.b64encode(points + uv).decode()

    def write(folder: Path) -> Path:
        document: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": 60, "uri": buffer or own}],
            "bufferViews": [
                {"buffer": 0, "byteLength": 36},
                {"buffer": 0, "byteOffset": 36, "byteLength": 24},
            ],
            "accessors": [
                {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
                {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"},
            ],
            "meshes": [
                {"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}
            ],
            "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
            "textures": [{"source": 0}],
            "images": [{"uri": image or "secret.png"}],
            "nodes": [{"mesh": 0}],
            "scenes": [{"nodes": [0]}],
            "scene": 0,
        }
        (folder / "a.gltf").write_text(json.dumps(document | more))
        return folder / "a.gltf"

    return write


def ply(folder: Path) -> Path:
    head = "ply\nformat ascii 1.0\ncomment TextureFile ../outside/secret.png\n"
    head += "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    head += "property float s\nproperty float t\nelement face 1\n"
    head += "property list uchar int vertex_indices\nend_header\n"
    (folder / "a.ply").write_text(head + "0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n")
    return folder / "a.ply"


ELSEWHERE = ["../outside/secret.png", "link.png", "http://127.0.0.1:9/secret.png"]
ELSEWHERE += ["/etc/secret.png", "file:///etc/secret.png", "%2e%2e/outside/secret.png"]


@pytest.mark.parametrize("name", ELSEWHERE)
@pytest.mark.parametrize("kind", ["obj", "gltf"])
def test_textures_elsewhere_are_refused_by_name(top: Path, kind: str, name: str) -> None:
    file = (obj(f"map_Kd {name}") if kind == "obj" else gltf(name))(top / "root")
    with pytest.raises(InvalidInputError, match="own folder or in the asset roots, not to") as no:
        load_mesh(file)
    assert name in str(no.value)


@pytest.mark.parametrize(
    "write",
    [
        obj(library="../outside/secret.mtl"),
        gltf(buffer="../outside/secret.bin"),
        gltf(buffer="http://127.0.0.1:9/secret.bin"),
        ply,
    ],
    ids=["materials", "buffer", "address", "ply"],
)
def test_other_references_elsewhere_are_refused(top: Path, write: Callable[[Path], Path]) -> None:
    with pytest.raises(InvalidInputError, match="own folder or in the asset roots"):
        load_mesh(write(top / "root"))


@pytest.mark.parametrize("write", [obj(), gltf()], ids=["obj", "gltf"])
def test_files_beside_are_read(top: Path, write: Callable[[Path], Path]) -> None:
    mesh = load_mesh(write(top / "root"))
    assert mesh.color_image_srgb is not None
    assert (mesh.color_image_srgb == (9, 8, 7)).all()


def test_files_in_another_asset_root_are_read(top: Path) -> None:
    file = obj("map_Kd ../outside/secret.png")(top / "root")
    with confine_paths(AssetRoots((top / "root", top / "outside"))):
        assert load_mesh(file).color_image_srgb is not None


def huge_png() -> bytes:
    data = bytearray(encode_image(np.zeros((2, 2), np.uint8)))
    data[16:24] = struct.pack(">II", 60_000, 60_000)
    return bytes(data)


def png_uri() -> str:
    return "data:image/png;base64," + base64.b64encode(huge_png()).decode()


def huge_texture(folder: Path) -> Path:
    (folder / "secret.png").write_bytes(huge_png())
    return obj()(folder)


def glb_with_a_huge_texture(folder: Path) -> Path:
    box = trimesh.creation.box()
    image = Image.new("RGB", (2, 2))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=image)
    box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=material)
    data = box.export(file_type="glb")
    start = data.index(b"\x89PNG")
    place = start + 16
    (folder / "a.glb").write_bytes(
        data[:place] + struct.pack(">II", 60_000, 60_000) + data[place + 8 :]
    )
    return folder / "a.glb"


def binary_ply(folder: Path, count: int = 10**10) -> Path:
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\nproperty float x\n"
    head += "property float y\nproperty float z\nelement face 1\n"
    head += "property list uchar int vertex_indices\nend_header\n"
    (folder / "a.ply").write_bytes(head.encode() + bytes(100))
    return folder / "a.ply"


def stl(folder: Path) -> Path:
    (folder / "a.stl").write_bytes(bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(200))
    return folder / "a.stl"


def instanced(folder: Path) -> Path:
    nodes = [{"mesh": 0}] * 200_000
    return gltf(nodes=nodes, scenes=[{"nodes": list(range(200_000))}])(folder)


def chained(folder: Path) -> Path:
    nodes = [{"children": [n + 1]} for n in range(5000)] + [{"mesh": 0}]
    return gltf(nodes=nodes)(folder)


ACCESSORS = [
    {"componentType": 5126, "count": 10**12, "type": "VEC3"},
    {"componentType": 5126, "count": 3, "type": "VEC2"},
]
BOMBS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "a texture": (huge_texture, "not 60000 x 60000"),
    "a texture in a URI": (gltf(png_uri()), "not 60000 x 60000"),
    "a texture in a glb": (glb_with_a_huge_texture, "not 60000 x 60000"),
    "accessors": (gltf(accessors=ACCESSORS), "elements, not 1000000000000"),
    "instances": (instanced, "at most 100000 nodes"),
    "a chain of nodes": (chained, "nested at most 200"),
    "nodes in a circle": (gltf(nodes=[{"children": [0], "mesh": 0}]), "glTF"),
    "ply": (binary_ply, "not 10000000000 vertex"),
    "ply that fits the bound": (lambda folder: binary_ply(folder, 10**7), "fit into its"),
    "stl": (stl, "not 4294967295"),
}


@pytest.mark.timeout(60)
@pytest.mark.parametrize("what", BOMBS)
def test_more_than_there_is_or_may_be_is_refused(top: Path, what: str) -> None:
    write, expected = BOMBS[what]
    with pytest.raises(InvalidInputError, match=expected):
        load_mesh(write(top / "root"))


PLY_HEADER = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    "property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
)
ROWS = ["0.000 0 0", "1.000 0 0", "1.000 1 0", "0.000 1 0", "3 0 1 2", "3 0 2 3"]
INCOMPLETE_PLY = {
    "a face less": (ROWS[:5], "2 rows of the element face, not 1"),
    "a face cut off": (
        [*ROWS[:5], "3 0"],
        "4 numbers in a row of the element face, not 2: line 15",
    ),
    "a vertex less": (ROWS[1:], "3 numbers in a row of the element vertex, not 4: line 13"),
    "no vertices": ([], "4 rows of the element vertex, not 0"),
    "a row more": ([*ROWS, "3 1 2 3"], "the 6 rows that its header announces, not more: line 16"),
    "an empty row": ([*ROWS[:2], "", *ROWS[2:]], "3 numbers in a row of .*, not 0: line 12"),
    "two rows in one line": ([" ".join(ROWS[:2]), *ROWS[2:]], "3 numbers .*, not 6: line 10"),
    "a word": (["x 0 0", *ROWS[1:]], "numbers, not 'x': line 10"),
    "joined digits": (["1_0 0 0", *ROWS[1:]], "numbers, not '1_0': line 10"),
    "half an index": ([*ROWS[:5], "3 0 2.5 3"], "whole numbers from .* not 2.5: line 15"),
}


@pytest.mark.parametrize("what", INCOMPLETE_PLY)
def test_a_text_ply_has_the_rows_that_it_announces(tmp_path: Path, what: str) -> None:
    rows, expected = INCOMPLETE_PLY[what]
    path = tmp_path / "a.ply"
    path.write_text(PLY_HEADER + "".join(f"{row}\n" for row in ROWS) + "\n \n")
    assert len(load_mesh(path).triangles) == 2
    path.write_text(PLY_HEADER + "\n".join(rows))
    with pytest.raises(InvalidInputError, match=rf"a\.ply.*{expected}"):
        load_mesh(path)


@pytest.mark.parametrize(
    ("line", "changed", "expected"),
    [
        ("element vertex 4", "element vertex", "names each element with its number"),
        ("element vertex 4", "element vertex four", "names each element with its number"),
        ("element vertex 4", "element vertex -4", "not -4 vertex"),
        ("property float x", "property", "type and name of each property, not 'property'"),
        ("property float x", "property list x", "type and name of each property"),
        ("property float x", "property flaot x", "readable .ply file"),
    ],
)
def test_a_header_of_a_ply_that_is_not_whole_is_refused(
    tmp_path: Path, line: str, changed: str, expected: str
) -> None:
    path = tmp_path / "a.ply"
    path.write_text(PLY_HEADER.replace(line, changed) + "\n".join(ROWS))
    with pytest.raises(InvalidInputError, match=expected):
        load_mesh(path)


def facets(name: str, *heights: int) -> str:
    """A solid of a text STL file."""
    loops = (
        f"facet normal 0 0 1\nouter loop\nvertex 0 0 {z}\nvertex 1 0 {z}\nvertex 0 1 {z}\n"
        "endloop\nendfacet\n"
        for z in heights
    )
    return f"solid {name}\n{''.join(loops)}endsolid {name}\n"


@pytest.mark.parametrize("solids", [("a",), ("a", "b")])
def test_a_text_stl_that_is_cut_anywhere_is_refused(
    tmp_path: Path, solids: tuple[str, ...]
) -> None:
    whole = "".join(facets(name, 0, 1, 2) for name in solids)
    path = tmp_path / "a.stl"
    for text in (whole, whole.upper(), whole.replace("\n", "\r\n"), whole.replace("\n", "\n\t")):
        path.write_bytes(text.encode())
        assert len(load_mesh(path).triangles) == 3 * len(solids)
    for kept in range(len("solid"), whole.rindex("endsolid") + len("endsolid")):
        if re.search(r"endsolid( a?)?\n?$", whole[:kept]) is None:
            path.write_text(whole[:kept])
            with pytest.raises(InvalidInputError, match=r"a\.stl"):
                load_mesh(path)


def test_a_solid_whose_name_is_read_as_facets_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    path.write_text(facets("vertex 0 0 0 vertex 0 0 0 vertex 0 0 0", 0, 1))
    with pytest.raises(InvalidInputError, match="2 facets that can be read, not 3"):
        load_mesh(path)


@pytest.mark.parametrize("more", [b"", b"more", bytes(50)])
def test_a_binary_stl_is_as_long_as_its_count_says(tmp_path: Path, more: bytes) -> None:
    triangle = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
    path = tmp_path / "a.stl"
    for count in (1, 2) if more else (2,):
        path.write_bytes(b"solid a".ljust(80) + struct.pack("<I", count) + triangle + more)
        if count == 2 and len(more) == 50:
            assert len(load_mesh(path).triangles) == 2
            continue
        with pytest.raises(InvalidInputError, match=f"bytes for its {count} triangles, not"):
            load_mesh(path)


MALFORMED: dict[str, tuple[dict[str, Any], str]] = {
    "asset": ({"asset": []}, r"asset must be an object, not \[\]"),
    "extensions": ({"extensionsRequired": 5}, "extensionsRequired must be a list, not 5"),
    "names": ({"extensionsRequired": [5]}, "extensionsRequired.0 must be text, not 5"),
    "texture": ({"textures": [3]}, "textures.0 must be an object, not 3"),
    "its extensions": (
        {"textures": [{"extensions": 3}]},
        "textures.0.extensions must be an object",
    ),
    "an extension": (
        {"textures": [{"extensions": {"EXT_texture_webp": [1]}}]},
        "textures.0.extensions.EXT_texture_webp must be an object",
    ),
    "primitive": ({"meshes": [{"primitives": [3]}]}, "meshes.0.primitives.0 must be an object"),
    "primitives": ({"meshes": [{"primitives": "x"}]}, "meshes.0.primitives must be a list"),
    "attributes": (
        {"meshes": [{"primitives": [{"attributes": [0]}]}]},
        "meshes.0.primitives.0.attributes must be an object",
    ),
    "accessor -1": (
        {"meshes": [{"primitives": [{"attributes": {"POSITION": -1}}]}]},
        "attributes.POSITION must be an index, from 0, of one of the 2 accessors, not -1",
    ),
    "indices -1": (
        {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": -1}]}]},
        "primitives.0.indices must be an index",
    ),
    "node -1": (
        {"scenes": [{"nodes": [-1]}]},
        "scenes.0.nodes.0 must be an index, .* nodes, not -1",
    ),
    "node of true": ({"scenes": [{"nodes": [True]}]}, "scenes.0.nodes.0 must be an index"),
    "child -1": ({"nodes": [{"mesh": 0, "children": [-1]}]}, "nodes.0.children.0 must be an index"),
    "children": ({"nodes": [{"mesh": 0, "children": 3}]}, "nodes.0.children must be a list"),
    "nodes as text": ({"scenes": [{"nodes": "0"}]}, "scenes.0.nodes must be a list, not '0'"),
    "scene -1": ({"scene": -1}, "scene must be an index, from 0, of one of the 1 scenes, not -1"),
    "scene 9": ({"scene": 9}, "scene must be an index"),
    "mesh -1": ({"nodes": [{"mesh": -1}]}, "nodes.0.mesh must be an index"),
    "source -1": ({"textures": [{"source": -1}]}, "textures.0.source must be an index"),
    "materials": ({"materials": 3}, "material"),
    "pbr": ({"materials": [{"pbrMetallicRoughness": 3}]}, "pbrMetallicRoughness must be an object"),
    "emission": ({"materials": [{"emissiveFactor": 3}]}, "TypeError"),
    "an address": (
        {"buffers": [{"byteLength": 60, "uri": 7}]},
        "buffers.0.uri must be text, not 7",
    ),
    "an image": ({"images": [{"uri": "data:image/png;base64,abc"}]}, "padding"),
    "a shear": (
        {"nodes": [{"mesh": 0, "matrix": [1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}]},
        "0, 0, 0, 1 in its last row",
    ),
    "no stride": (
        {"bufferViews": [{"buffer": 0, "byteLength": 36, "byteStride": 0}, {"byteLength": 24}]},
        "a byteStride from 4 to 252 in buffer view 0, not 0",
    ),
    "a stride": (
        {"bufferViews": [{"buffer": 0, "byteLength": 60, "byteStride": 4}, {"byteLength": 24}]},
        "overlap",
    ),
}


@pytest.mark.parametrize("what", MALFORMED)
def test_a_malformed_gltf_is_refused_by_the_place(top: Path, what: str) -> None:
    more, expected = MALFORMED[what]
    path = gltf(**more)(top / "root")
    with pytest.raises(InvalidInputError, match=expected) as error:
        load_mesh(path, field="stage.mesh.file")
    assert error.value.field == "stage.mesh.file"
    assert error.value.received == str(path)


def test_a_glb_whose_parts_announce_more_than_there_is_is_refused(tmp_path: Path) -> None:
    data = trimesh.creation.box().export(file_type="glb")
    (length,) = struct.unpack_from("<I", data, 12)
    path = tmp_path / "a.glb"
    for place, what in ((12, "JSON"), (20 + length, "binary")):
        huge = data[:place] + struct.pack("<I", 2**32 - 1) + data[place + 4 :]
        path.write_bytes(huge)
        with pytest.raises(InvalidInputError, match=f"its {what} part announces 4294967295 bytes"):
            load_mesh(path)
    path.write_bytes(data)
    assert len(load_mesh(path).triangles) == 12
