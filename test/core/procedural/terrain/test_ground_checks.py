"""Stages that a file gives: as large as ``stage.extent_m`` may be, and with ground to stand on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from oaisys_core.config.sections.stage import DemConfig, StageMeshConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.terrain.dem import import_dem
from oaisys_core.world.modules.stage import load_mesh_ground

LEVEL = "v 0 0 0\nv {0} 0 0\nv 0 {1} 0\nf 1 2 3\n"


def mesh(folder: Path, text: str) -> StageMeshConfig:
    (folder / "stage.obj").write_text(text)
    return StageMeshConfig(file=folder / "stage.obj")


@pytest.mark.parametrize("edges", [(1e-4, 1e-4), (9e-3, 50), (50, 9e-3), (1.9e7, 50)])
def test_meshes_whose_edges_no_stage_can_have_are_refused(
    tmp_path: Path, edges: tuple[float, float]
) -> None:
    """One of a tenth of a millimetre took minutes, in which a server answered nobody."""
    x_m, y_m = edges
    text = f"v {-x_m / 2} 0 0\nv {x_m / 2} 0 0\nv 0 {y_m} 0\nf 1 2 3\n"
    with pytest.raises(InvalidInputError, match=r"mesh\.file: .*of 0\.01 to 1e\+07 m in x and"):
        load_mesh_ground(mesh(tmp_path, text))


def test_scale_counts_in_the_size_of_a_mesh(tmp_path: Path) -> None:
    config = mesh(tmp_path, LEVEL.format(0.5, 0.5))
    assert load_mesh_ground(config.model_copy(update={"scale": 0.02})).extent_m[2] <= 0.01001
    with pytest.raises(InvalidInputError, match=r"not 0\.005 x 0\.005 m"):
        load_mesh_ground(config.model_copy(update={"scale": 0.01}))


@pytest.mark.parametrize("spacing_m", [1e-6, 1e7])
def test_elevation_models_whose_edges_no_stage_can_have_are_refused(
    tmp_path: Path, spacing_m: float
) -> None:
    rows = "\n".join(" ".join(str(i * j % 7) for j in range(9)) for i in range(9))
    head = "ncols 9\nnrows 9\nxllcorner 0\nyllcorner 0\ncellsize 1\n"
    (tmp_path / "dem.asc").write_text(head + rows + "\n")
    config = DemConfig(file=tmp_path / "dem.asc", spacing_m=spacing_m)
    with pytest.raises(InvalidInputError, match=r"dem\.file: .*of 0\.01 to 1e\+07 m in x and"):
        import_dem(config)
    extent_m = import_dem(config.model_copy(update={"spacing_m": 0.00125})).ground.extent_m
    np.testing.assert_allclose(extent_m, (-0.005, -0.005, 0.005, 0.005), rtol=1e-6)


@pytest.mark.parametrize("across_m", [0.0, 1e-4, 10.0])
def test_a_mesh_of_vertical_triangles_is_refused(tmp_path: Path, across_m: float) -> None:
    """It ended commands with a division by zero, or a pose at a height of NaN was blamed."""
    wall = f"v 0 0 0\nv 10 {across_m} 0\nv 0 0 10\nf 1 2 3\n"
    with pytest.raises(InvalidInputError, match=r"stage\.mesh\.file: .*(seen from above|10 x )"):
        load_mesh_ground(mesh(tmp_path, wall))


def test_a_path_across_its_extent_is_a_ground(tmp_path: Path) -> None:
    """2 km by 2 m, as the diagonal of a square: a 1400th of it has ground."""
    text = "v 0 0 0\nv 1.4 -1.4 0\nv 1414 1414 9\nv 1415.4 1412.6 9\nf 1 2 3\nf 2 4 3\n"
    assert load_mesh_ground(mesh(tmp_path, text)).extent_m[2] == pytest.approx(1415.4)


def grid_and_square(edge_m: float, cells: int) -> str:
    """A level square around the origin, and in its corner a grid of cells of 0.2 m."""
    half = edge_m / 2
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    grid = [(half - 0.2 * i, half - 0.2 * j) for i in range(cells + 1) for j in range(cells + 1)]
    lines = [f"v {x} {y} 0" for x, y in (*corners, *grid)]
    lines += ["f 1 2 3", "f 1 3 4"]
    for i in range(cells):
        for j in range(cells):
            at = 5 + i * (cells + 1) + j
            lines.append(f"f {at} {at + cells + 1} {at + cells + 2} {at + 1}")
    return "\n".join([*lines, ""])


def test_triangles_that_float32_does_not_resolve_are_refused(tmp_path: Path) -> None:
    """Floats of 32 bits have steps of 6 cm at 1,000 km: heights were metres off, exit 0."""
    told = r"mesh\.file: .*over an extent of 2e\+06 x 2e\+06 m.*reach 0\.0625 m, and 800 of 802"
    with pytest.raises(InvalidInputError, match=told):
        load_mesh_ground(mesh(tmp_path, grid_and_square(2e6, 20)))
    assert load_mesh_ground(mesh(tmp_path, grid_and_square(1e5, 20))).extent_m[2] == 5e4


def test_large_triangles_may_have_any_extent(tmp_path: Path) -> None:
    assert load_mesh_ground(mesh(tmp_path, LEVEL.format(2e6, 2e6))).extent_m[2] == 2e6


def test_parts_far_apart_are_told_as_such(tmp_path: Path) -> None:
    apart = LEVEL.format(1, 1) + "v 9000 9000 0\nv 9001 9000 0\nv 9000 9001 0\nf 4 5 6\n"
    with pytest.raises(InvalidInputError, match="between parts that lie far apart there is none"):
        load_mesh_ground(mesh(tmp_path, apart))
