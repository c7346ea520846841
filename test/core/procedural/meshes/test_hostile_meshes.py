"""Mesh files that refer to files elsewhere, or announce more than they contain."""

from __future__ import annotations

import base64
import json
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
