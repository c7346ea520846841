"""CSV files are read by the names of their columns; what has no name is not lost in silence."""

from __future__ import annotations

from pathlib import Path

import pytest

from oaisys_core.files.csv_tables import parse_numbered_csv, read_csv
from oaisys_core.files.documents import DocumentError


def test_rows_come_by_the_names_of_their_columns(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(b"\xef\xbb\xbfx_m , y_m\n# a remark\n\n1, 2\n3,4,\n")
    assert read_csv(path, 9) == [{"x_m": "1", "y_m": "2"}, {"x_m": "3", "y_m": "4"}]


def test_values_without_a_name_are_refused() -> None:
    with pytest.raises(DocumentError, match="line 3 has more values than the first line has names"):
        parse_numbered_csv("x_m,y_m\n1,2\n1,2,3\n", 9)


def test_columns_behind_those_that_are_asked_for_are_left_out() -> None:
    assert parse_numbered_csv("1,2,3\n", 9, ["x_m", "y_m"]) == [(1, {"x_m": "1", "y_m": "2"})]


def test_a_column_that_comes_twice_is_refused() -> None:
    with pytest.raises(DocumentError, match="'x_m' comes twice"):
        parse_numbered_csv("x_m,y_m,x_m\n1,2,3\n", 9)
