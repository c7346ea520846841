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
