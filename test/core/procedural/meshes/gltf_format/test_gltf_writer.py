"""What we write as .glb is what trimesh and we read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from oaisys_core.procedural.meshes.files import load_mesh
from oaisys_core.procedural.meshes.gltf_format.gltf_writer import write_glb
from oaisys_core.procedural.meshes.loaded import LoadedMesh
from oaisys_core.scene import MeshMaterial


def mesh() -> LoadedMesh:
    """Return three triangles: one with an image, one with a dark colour, one with holes."""
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (8, 8, 3), np.uint8)
    opacity = np.where(np.arange(64).reshape(8, 8) % 3, 255, 0).astype(np.uint8)
    return LoadedMesh(
        "bot",
        rng.normal(size=(7, 3)).astype(np.float32),
        np.array([(0, 1, 2), (2, 3, 4), (4, 5, 6)], np.int32),
        uv=rng.random((3, 3, 2)).astype(np.float32),
        vertex_colors_srgb=np.array([(c, 255 - c, 7) for c in range(7)], np.uint8),
        materials=(
            MeshMaterial("picture", color_image_srgb=image, wrap=("clamp", "mirror")),
            MeshMaterial("dark", color_srgb=(0.02, 0.03, 0.5)),
            MeshMaterial("leaf", (1, 0.5, 0.25), opacity=opacity, cutoff=100.0),
        ),
        material_of=np.array([0, 1, 2], np.uint16),
    )


def test_a_mesh_comes_back(tmp_path: Path) -> None:
    wanted = mesh()
    write_glb(tmp_path / "bot.glb", wanted)
    found = load_mesh(tmp_path / "bot.glb")
    assert found.material_of is not None
    assert found.uv is not None
    assert wanted.uv is not None
    corners = found.triangles[np.argsort(found.material_of)].ravel()
    np.testing.assert_allclose(
        found.vertices_m[corners], wanted.vertices_m[wanted.triangles.ravel()], atol=1e-6
    )
    np.testing.assert_allclose(found.uv, wanted.uv, atol=1e-6)
    assert wanted.vertex_colors_srgb is not None
    assert found.vertex_colors_srgb is not None
    np.testing.assert_array_equal(
        found.vertex_colors_srgb[corners], wanted.vertex_colors_srgb[wanted.triangles.ravel()]
    )
    for a, b in zip(found.materials, wanted.materials, strict=True):
        assert a.name == b.name
        np.testing.assert_allclose(a.color_srgb, b.color_srgb, atol=1e-6)
        assert a.wrap == b.wrap
    first, _, leaf = found.materials
    image, opacity = wanted.materials[0].color_image_srgb, wanted.materials[2].opacity
    assert first.color_image_srgb is not None
    assert image is not None
    np.testing.assert_array_equal(first.color_image_srgb, image)
    assert leaf.opacity is not None
    assert opacity is not None
    np.testing.assert_array_equal(leaf.opacity, opacity)


def test_trimesh_reads_it_with_y_up(tmp_path: Path) -> None:
    write_glb(tmp_path / "bot.glb", mesh())
    scene = trimesh.load_scene(tmp_path / "bot.glb")
    x, y, z = scene.to_geometry().bounds.T
    points = mesh().vertices_m
    np.testing.assert_allclose(x, (points[:, 0].min(), points[:, 0].max()), atol=1e-6)
    np.testing.assert_allclose(y, (points[:, 2].min(), points[:, 2].max()), atol=1e-6)
    np.testing.assert_allclose(z, (-points[:, 1].max(), -points[:, 1].min()), atol=1e-6)
