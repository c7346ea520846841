"""Materials of .obj files, by the MTL specification."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.meshes.files import load_mesh
from oaisys_core.procedural.meshes.loaded import LoadedMesh

HEAD = "v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
SQUARE = "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"


def load(folder: Path, mtl: str, text: str = "mtllib a.mtl\nusemtl m\n" + SQUARE) -> LoadedMesh:
    (folder / "a.mtl").write_text(mtl)
    first, _, rest = text.partition("\n")
    (folder / "a.obj").write_text(f"{first}\n{HEAD}{rest}")
    return load_mesh(folder / "a.obj")


def save(path: Path, color: tuple[int, ...]) -> None:
    Image.fromarray(np.full((4, 4, len(color)), color, np.uint8)).save(path)


def test_every_material_keeps_its_image(tmp_path: Path) -> None:
    save(tmp_path / "red wall.png", (200, 0, 0))
    save(tmp_path / "blue.png", (0, 0, 200))
    mtl = "newmtl m\nKd 1 1 1\nmap_Kd red wall.png\nnewmtl other\nmap_Kd blue.png\n"
    text = "mtllib a.mtl\nusemtl m\nf 1/1 2/2 3/3\nusemtl other\nf 1/1 3/3 4/4\n"
    mesh = load(tmp_path, mtl, text)
    images = {m.name: m.color_image_srgb for m in mesh.materials}
    assert images["m"] is not None
    assert images["m"][0, 0].tolist() == [200, 0, 0]
    assert images["other"] is not None
    assert images["other"][0, 0].tolist() == [0, 0, 200]
    assert mesh.material_of is not None
    lower = np.isclose(mesh.vertices_m[mesh.triangles][..., 0].sum(axis=1), 2)
    names = [mesh.materials[index].name for index in mesh.material_of[np.argsort(~lower)]]
    assert names == ["m", "other"]


def test_an_image_is_multiplied_by_kd_and_placed_by_its_options(tmp_path: Path) -> None:
    save(tmp_path / "a.png", (255, 255, 255))
    mesh = load(tmp_path, "newmtl m\nKd 0.5 1 0\nmap_Kd -s 2 3 1 -o 0.25 0 0 -clamp on a.png\n")
    assert mesh.color_image_srgb is not None
    # Kd is read as sRGB, as it always was.
    assert mesh.color_image_srgb[0, 0].tolist() == [128, 255, 0]
    assert mesh.uv is not None
    np.testing.assert_allclose(mesh.uv.reshape(-1, 2).max(axis=0), (2.25, 3.0))
    assert mesh.materials[0].wrap == ("clamp", "clamp")


def test_black_kd_beside_an_image_does_not_hide_it(tmp_path: Path) -> None:
    save(tmp_path / "a.png", (9, 8, 7))
    mesh = load(tmp_path, "newmtl m\nKd 0 0 0\nmap_Kd a.png\n")
    assert mesh.color_image_srgb is not None
    assert mesh.color_image_srgb[0, 0].tolist() == [9, 8, 7]


@pytest.mark.parametrize("kind", ["grey", "alpha"])
def test_map_d_cuts_out(tmp_path: Path, kind: str) -> None:
    pixels = np.full((2, 2, 4 if kind == "alpha" else 3), 255, np.uint8)
    pixels[0, 1, 3 if kind == "alpha" else slice(None)] = 0
    Image.fromarray(pixels).save(tmp_path / "a.png")
    (material,) = load(tmp_path, "newmtl m\nKd 1 0 0\nmap_d a.png\n").materials
    assert material.opacity is not None
    assert (material.opacity >= material.cutoff).tolist() == [[True, False], [True, True]]


def test_a_missing_library_picture_or_material_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        load(tmp_path, "newmtl m\nmap_Kd gone.png\n")
        assert "gone.png" in caplog.text
        load(tmp_path, "newmtl n\n")
        assert "no .mtl file has these materials, so they are grey: m" in caplog.text
        load(tmp_path, "", "mtllib away.mtl\nusemtl m\n" + SQUARE)
    assert "away.mtl" in caplog.text


def test_a_picture_that_ends_too_early_is_refused_by_name(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (32, 32, 3)).astype(np.uint8)
    Image.fromarray(pixels).save(tmp_path / "cut.png")
    (tmp_path / "cut.png").write_bytes((tmp_path / "cut.png").read_bytes()[:1000])
    with pytest.raises(InvalidInputError, match=r"cut\.png.*truncated"):
        load(tmp_path, "newmtl m\nmap_Kd cut.png\n")


def test_several_libraries_and_objects_are_read(tmp_path: Path) -> None:
    (tmp_path / "b.mtl").write_text("newmtl second\nKd 0 0 1\n")
    text = "mtllib a.mtl b.mtl\no left\nusemtl m\nf 1 2 3\no right\nusemtl second\nf 1 3 4\n"
    mesh = load(tmp_path, "newmtl m\nKd 1 0 0\n", text)
    assert {m.name: m.color_srgb for m in mesh.materials} == {"m": (1, 0, 0), "second": (0, 0, 1)}
    right = load_mesh(tmp_path / "a.obj", "right")
    assert [m.name for m in right.materials] == ["second"]
    assert len(right.triangles) == 1
