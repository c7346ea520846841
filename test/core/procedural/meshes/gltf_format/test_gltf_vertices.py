"""Where the vertices of glTF files are (glTF 2.0, §3.7), with skins and morph targets."""

from __future__ import annotations

import base64
import json
import logging
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_files import SQUARE, GltfFile, base_color

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.meshes.files import load_mesh
from oaisys_core.procedural.meshes.loaded import LoadedMesh

FIRST = np.array([[1, 0, 0, 0]] * 4, np.float32)
"""Weights that give each vertex to the first joint."""


def move(x: float, y: float, z: float) -> list[float]:
    """A translation as glTF has matrices: column by column."""
    return [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1]


def skinned(
    weights: np.ndarray = FIRST,
    joints: tuple[int, ...] = (0, 1, 0, 0),
    inverse: list[list[float]] | None = None,
    **more: Any,
) -> GltfFile:
    """A square on a node at x = 50 whose skin has two joints: at (0, 5, 0), and 2 above it."""
    file = GltfFile()
    of_vertex = file.accessor(np.array([joints] * 4, np.uint8))
    shares = file.accessor(weights, normalized=weights.dtype != np.float32)
    file.square(None, JOINTS_0=of_vertex, WEIGHTS_0=shares)
    skin: dict[str, Any] = {"joints": [2, 3]}
    if inverse is not None:
        index = file.accessor(np.array(inverse, np.float32))
        file.document["accessors"][index]["type"] = "MAT4"
        file.document["accessors"][index]["count"] = len(inverse)
        skin["inverseBindMatrices"] = index
    nodes = [
        {"mesh": 0, "skin": 0, "translation": [50, 0, 0], "name": "thing"},
        {"translation": [0, 5, 0], "children": [2]},
        {"children": [3]},
        {"translation": [0, 2, 0]},
    ]
    file.document |= {"nodes": nodes, "scenes": [{"nodes": [0, 1]}], "skins": [skin]} | more
    return file


def points(file: GltfFile, folder: Path) -> np.ndarray:
    """Return the vertices in the axes of the file, y up."""
    x, y, z = load_mesh(file.save(folder / "a.gltf")).vertices_m.T.astype(float)
    return np.stack((x, z, -y), axis=1)


def test_a_skin_takes_the_place_of_its_nodes_pose(tmp_path: Path) -> None:
    bound = [move(0, -5, 0), move(0, -7, 0)]
    found = points(skinned(inverse=bound), tmp_path)
    np.testing.assert_allclose(found, SQUARE, atol=1e-6)
    # Without inverse bind matrices these are of 1, so the joints' poses remain.
    found = points(skinned(), tmp_path)
    np.testing.assert_allclose(found, SQUARE + np.array([0, 5, 0]), atol=1e-6)


def test_weights_blend_the_joints(tmp_path: Path) -> None:
    weights = np.array(
        [(255, 0, 0, 0), (0, 255, 0, 0), (51, 204, 0, 0), (102, 153, 0, 0)], np.uint8
    )
    found = points(skinned(weights), tmp_path)
    up = np.array([5, 7, 5 + 2 * 0.8, 5 + 2 * 0.6])
    np.testing.assert_allclose(found, SQUARE + np.outer(up, [0, 1, 0]), atol=1e-6)
    # A sum that is not 1 does not scale the mesh.
    found = points(skinned(0.5 * FIRST), tmp_path)
    np.testing.assert_allclose(found, SQUARE + np.array([0, 5, 0]), atol=1e-6)


def test_turned_and_scaled_joints_pose_a_mesh_as_in_blender(tmp_path: Path) -> None:
    weights = np.array([(255, 0, 0, 0), (0, 255, 0, 0), (51, 204, 0, 0), (102, 153, 0, 0)])
    file = skinned(weights.astype(np.uint8), inverse=[move(0, -4, 1), move(0.5, -6, 0)])
    file.document["nodes"][2]["rotation"] = [0, 0, 0.3826834, 0.9238795]
    file.document["nodes"][3]["scale"] = [1, 2, 1]
    # Of the mesh that the importer of Blender 4.5 makes of this file.
    expected = [
        (2.8284268, 2.1715727, 1.0),
        (8.1317282, -1.0104084, 0.0),
        (5.9396973, 1.0402017, 0.2),
        (4.4547728, 0.9694910, 0.4),
    ]
    np.testing.assert_allclose(points(file, tmp_path), expected, atol=2e-6)


def test_a_turned_and_mirrored_joint_keeps_the_outside_outside(tmp_path: Path) -> None:
    file = skinned()
    file.document["nodes"][2]["scale"] = [-1, 1, 1]
    mesh = load_mesh(file.save(tmp_path / "a.gltf"))
    a, b, c = (mesh.vertices_m[mesh.triangles[0, corner]] for corner in range(3))
    # The square faces +z of the file, which is -y here; a mirror at x = 0 leaves that.
    assert np.cross(b - a, c - a)[1] < 0
    assert mesh.vertices_m[:, 0].min() == -1


SKINS: dict[str, tuple[GltfFile, str]] = {
    "a joint beyond": (skinned(joints=(7, 0, 0, 0)), "joints below 2, as its skin has, not 7"),
    "no weight": (skinned(0 * FIRST), "weights of 0 or more, and not all 0: mesh 0, vertex 0"),
    "a negative weight": (skinned(-FIRST), "weights of 0 or more"),
    "few matrices": (skinned(inverse=[move(0, 0, 0)]), "of each of 2 joints, not 1: skin 0"),
    "a projection": (skinned(inverse=[[1.0] * 16] * 2), "0, 0, 0, 1 in their last row: skin 0"),
    "no skin": (skinned(skins=[]), "nodes.0.skin must be an index"),
    "a node": (skinned(skins=[{"joints": [9]}]), "skins.0.joints.0 must be an index"),
}


@pytest.mark.parametrize("what", SKINS)
def test_a_skin_that_says_no_place_is_refused(tmp_path: Path, what: str) -> None:
    file, expected = SKINS[what]
    with pytest.raises(InvalidInputError, match=expected):
        points(file, tmp_path)


def test_a_skin_without_joints_at_the_vertices_is_refused(tmp_path: Path) -> None:
    file = skinned()
    del file.document["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]
    with pytest.raises(InvalidInputError, match="JOINTS_n and WEIGHTS_n"):
        points(file, tmp_path)


@pytest.mark.parametrize("place", ["node", "mesh"])
def test_morph_targets_count_by_the_weights_of_the_file(tmp_path: Path, place: str) -> None:
    file = GltfFile()
    file.square()
    up, aside = (file.accessor(np.array([step] * 4, np.float32)) for step in ((0, 1, 0), (1, 0, 0)))
    (primitive,) = file.document["meshes"][0]["primitives"]
    primitive["targets"] = [{"POSITION": up}, {"POSITION": aside}]
    np.testing.assert_allclose(points(file, tmp_path), SQUARE, atol=1e-6)
    file.document["meshes"][0]["weights"] = [0.0, 1.0]
    if place == "node":
        file.document["nodes"][0]["weights"] = [2.0, 0.5]
    expected = (0.5, 2, 0) if place == "node" else (1, 0, 0)
    np.testing.assert_allclose(points(file, tmp_path), SQUARE + expected, atol=1e-6)
    file.document["nodes"][0]["weights"] = [1.0]
    with pytest.raises(InvalidInputError, match="2 weights, one of each morph target, not 1"):
        points(file, tmp_path)


def square(name: str, values: np.ndarray, *, normalized: bool = False) -> GltfFile:
    file = GltfFile()
    file.square(base_color())
    (primitive,) = file.document["meshes"][0]["primitives"]
    primitive["attributes"][name] = file.accessor(values, normalized=normalized)
    return file


@pytest.mark.parametrize("count", [3, 5])
@pytest.mark.parametrize(
    ("name", "width"),
    [("COLOR_0", 3), ("COLOR_1", 4), ("NORMAL", 3), ("TANGENT", 4), ("TEXCOORD_1", 2)],
)
def test_attributes_of_another_count_are_refused(
    tmp_path: Path, name: str, width: int, count: int
) -> None:
    file = square(name, np.zeros((count, width), np.float32))
    with pytest.raises(InvalidInputError, match=f"{name} as of POSITION, 4, not {count}: mesh 0"):
        points(file, tmp_path)


ONES = np.ones((4, 3), np.float32)
ATTRIBUTES: dict[str, tuple[GltfFile, str]] = {
    "type": (square("COLOR_0", ONES[:, :2]), "COLOR_0 of type VEC3 or VEC4, not VEC2"),
    "integers": (square("COLOR_0", np.full((4, 3), 200, np.uint8)), "or normalized integers"),
    "above 1": (
        square("COLOR_0", 200 * ONES),
        r"COLOR_0 from 0 to 1, not \(200, 200, 200\): mesh 0",
    ),
    "below 0": (square("COLOR_0", -ONES), "COLOR_0 from 0 to 1"),
    "no number": (square("COLOR_0", np.nan * ONES), "COLOR_0 from 0 to 1"),
    "coordinates": (square("TEXCOORD_1", ONES), "TEXCOORD_1 of type VEC2, not VEC3"),
}


@pytest.mark.parametrize("what", ATTRIBUTES)
def test_attributes_of_another_kind_are_refused(tmp_path: Path, what: str) -> None:
    file, expected = ATTRIBUTES[what]
    with pytest.raises(InvalidInputError, match=expected):
        points(file, tmp_path)


def test_a_target_of_another_count_is_refused(tmp_path: Path) -> None:
    file = GltfFile()
    file.square()
    (primitive,) = file.document["meshes"][0]["primitives"]
    primitive["targets"] = [{"POSITION": file.accessor(ONES[:3])}]
    with pytest.raises(InvalidInputError, match="POSITION as of POSITION, 4, not 3"):
        points(file, tmp_path)


def test_materials_that_say_something_else_are_refused(tmp_path: Path) -> None:
    for color, expected in (
        (base_color(baseColorFactor=[204, 26, 51, 1]), r"from 0 to 1, not \[204, 26, 51, 1\]"),
        (base_color() | {"alphaMode": "Blend"}, "alphaMode of OPAQUE, MASK or BLEND, not 'Blend'"),
    ):
        file = GltfFile()
        file.square(color)
        with pytest.raises(InvalidInputError, match=expected):
            points(file, tmp_path)


def test_only_the_first_buffer_is_the_binary_part(tmp_path: Path) -> None:
    file = GltfFile()
    file.square()
    document = json.loads(file.save(tmp_path / "a.gltf").read_text())
    data = base64.b64decode(document["buffers"][0].pop("uri").partition(",")[2])
    data += b"\0" * (-len(data) % 4)

    def glb() -> LoadedMesh:
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        length = 12 + 8 + len(text) + 8 + len(data)
        head = b"glTF" + struct.pack("<II", 2, length) + struct.pack("<I4s", len(text), b"JSON")
        path = tmp_path / "a.glb"
        path.write_bytes(head + text + struct.pack("<I4s", len(data), b"BIN\0") + data)
        return load_mesh(path)

    assert len(glb().triangles) == 2
    document["buffers"] *= 2
    document["bufferViews"][0]["buffer"] = 1
    with pytest.raises(InvalidInputError, match="a uri of buffer 1"):
        glb()


def test_instances_that_only_an_extension_has_are_refused(tmp_path: Path) -> None:
    file = GltfFile()
    file.square()
    where = file.accessor(np.array([(0, 0, 0), (5, 0, 0)], np.float32))
    instances = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": where}}}
    file.document["nodes"][0]["extensions"] = instances
    file.document["extensionsUsed"] = list(instances)
    with pytest.raises(InvalidInputError, match="EXT_mesh_gpu_instancing: instances as nodes"):
        points(file, tmp_path)


def test_extensions_that_are_not_read_are_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = GltfFile()
    file.square()
    known = ["KHR_materials_ior", "KHR_texture_transform", "KHR_lights_punctual"]
    with caplog.at_level(logging.WARNING):
        load_mesh(file.save(tmp_path / "a.gltf", extensionsUsed=known))
        assert not caplog.records
        load_mesh(file.save(tmp_path / "a.gltf", extensionsUsed=[*known, "KHR_node_visibility"]))
    assert "extensions that are not read, which may change it: KHR_node_visibility" in caplog.text
