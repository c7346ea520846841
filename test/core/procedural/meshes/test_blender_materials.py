"""Materials and generators in files of Blender, COLLADA and USD."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from blender_process import in_blender

from oaisys_core.errors import BackendUnavailableError
from oaisys_core.procedural.meshes.files import load_mesh

pytestmark = pytest.mark.blender


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    top = tmp_path_factory.mktemp("textured")
    in_blender("files.save_textured_files", str(top))
    return top


def test_a_generator_that_draws_anew_is_frozen_and_named(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        first, second = (load_mesh(folder / "noise.blend").vertices_m for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert np.ptp(first[:, 2]) > 0.1, "it is rough, as before"
    assert "'Random' (Noise) has other values each time" in caplog.text


def test_the_image_behind_simple_nodes_is_shown_and_the_nodes_are_named(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        image = load_mesh(folder / "curves.blend").color_image_srgb
        assert image is not None
        assert image[0, 0].tolist() == [255, 0, 0]
        assert "'Darker'" in caplog.text
        (plain,) = load_mesh(folder / "procedural.blend").materials
    assert plain.color_image_srgb is None
    assert "node 'Cells' is not read" in caplog.text


def test_alpha_cuts_out_and_colours_are_linear(folder: Path) -> None:
    (leaf,) = load_mesh(folder / "leaf.blend").materials
    assert leaf.opacity is not None
    assert (leaf.opacity[:, 0] >= leaf.cutoff).tolist() == [True, True, False, False]
    (plain,) = load_mesh(folder / "plain.blend").materials
    assert [round(255 * value) for value in plain.color_srgb] == [72, 188, 124]


@pytest.mark.parametrize("name", ["plain.usda", "plain.dae"])
def test_usd_and_collada_come_as_blender_reads_them(folder: Path, name: str) -> None:
    path = folder / name
    if not path.exists():
        path.write_text("<COLLADA/>")
        with pytest.raises(BackendUnavailableError, match=r"save it as \.glb"):
            load_mesh(path)
        return
    mesh = load_mesh(path)
    np.testing.assert_allclose(np.ptp(mesh.vertices_m, axis=0), (2, 2, 0), atol=1e-5)
    (material,) = mesh.materials
    assert [round(255 * value) for value in material.color_srgb] == pytest.approx(
        [72, 188, 124], abs=1
    )
