"""Files of points that are damaged or made by somebody else."""

from __future__ import annotations

import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_core.output.points import decode_points


@pytest.mark.parametrize("count", ["9" * 30, "9" * 5000, "-5", "1_0", "x"])
def test_a_number_of_points_that_is_none_is_refused(count: str) -> None:
    head = f"VERSION 0.7\nFIELDS x y z\nPOINTS {count}\nDATA binary\n"
    with pytest.raises(InvalidInputError, match=r"points: received 'a\.pcd'.*a PCD file"):
        decode_points(head.encode() + bytes(100), "a.pcd")
