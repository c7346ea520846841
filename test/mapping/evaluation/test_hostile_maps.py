"""Maps and true meshes that announce more than they contain."""

from __future__ import annotations

from pathlib import Path

import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_mapping.evaluation.truth_io import read_truth
from oaisys_mapping.mesh_io import read_ply

HEADER = """ply
format binary_little_endian 1.0
element vertex {count}
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
"""


@pytest.mark.parametrize("count", [10**8, 10**12])
@pytest.mark.parametrize("read", [read_ply, read_truth])
def test_a_map_that_announces_more_than_it_contains_is_refused(
    tmp_path: Path, read: object, count: int
) -> None:
    file = tmp_path / "map.ply"
    file.write_bytes(HEADER.format(count=count).encode() + bytes(100))
    with pytest.raises(InvalidInputError, match=r"map\.ply.*(truncated|at most 400000000)"):
        read(file)  # type: ignore[operator]


@pytest.mark.parametrize("read", [read_ply, read_truth])
def test_a_map_that_is_text_and_cut_off_is_refused(tmp_path: Path, read: object) -> None:
    file = tmp_path / "map.ply"
    header = HEADER.replace("binary_little_endian", "ascii").format(count=4)
    rows = "0.000 0 0\n1.000 0 0\n1.000 1 0\n"
    file.write_text(f"{header}{rows}0.000 1 0\n3 0 1 2\n")
    read(file)  # type: ignore[operator]
    file.write_text(f"{header}{rows}3 0 1 2\n3 0 1 2\n")
    with pytest.raises(InvalidInputError, match=r"map\.ply.*3 numbers in a row.*line 13"):
        read(file)  # type: ignore[operator]


@pytest.mark.parametrize("read", [read_ply, read_truth])
def test_a_map_that_cannot_be_read_is_refused_in_a_sentence(read: object) -> None:
    expected = r"'/proc/self/mem', expected a file that can be read \(Input/output error\)$"
    with pytest.raises(InvalidInputError, match=expected):
        read(Path("/proc/self/mem"))  # type: ignore[operator]
