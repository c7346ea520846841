"""CSV files from outside, by the names of their columns, within bounds."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from oaisys_core.files.documents import DocumentError, read_text

MAX_ROW_BYTES = 256
"""Mean size of a row in a CSV file."""


def read_csv(
    path: Path, most_rows: int, columns: Sequence[str] | None = None
) -> list[dict[str, str]]:
    """Return the rows of a CSV file by the names of their columns, as `read_numbered_csv` does."""
    return [row for _, row in read_numbered_csv(path, most_rows, columns)]


def read_numbered_csv(
    path: Path, most_rows: int, columns: Sequence[str] | None = None
) -> list[tuple[int, dict[str, str]]]:
    """Return the rows of a CSV file by the names of their columns, each after its line's number.

    A byte order mark, lines that are empty or begin with ``#``, and spaces about the names and
    behind commas are left out.

    Args:
        path: The file.
        most_rows: How many it may have.
        columns: Names of the columns; None: the first row has them.

    Raises:
        OSError: It cannot be read.
        ValueError: It is no CSV file, or has more rows or bytes than it may.
    """
    text = read_text(path, most_rows * MAX_ROW_BYTES).removeprefix("\ufeff")
    return parse_numbered_csv(text, most_rows, columns)


def parse_numbered_csv(
    text: str, most_rows: int, columns: Sequence[str] | None = None
) -> list[tuple[int, dict[str, str]]]:
    """Return the rows of a CSV text without a byte order mark, as `read_numbered_csv` does.

    Raises:
        DocumentError: It is no CSV text, or has more rows than it may.
    """
    lines = text.splitlines(keepends=True)
    kept = [(n, s) for n, s in enumerate(lines, 1) if s.strip() and not s.lstrip().startswith("#")]
    rows: list[tuple[int, dict[str, str]]] = []
    try:
        reader = csv.DictReader((s for _, s in kept), columns, skipinitialspace=True)
        if columns is None and reader.fieldnames is not None:
            reader.fieldnames = [name.strip() for name in reader.fieldnames]
            _check_names(reader.fieldnames)
        for row in reader:
            if len(rows) == most_rows:
                raise DocumentError(f"it has more than {most_rows} rows")
            number = kept[reader.line_num - 1][0]
            unnamed = row.pop(None, [])
            # Tables without a line of names may go on with columns that nobody asks for.
            if columns is None and any(value.strip() for value in unnamed):
                raise DocumentError(f"line {number} has more values than the first line has names")
            rows.append((number, row))
    except csv.Error as error:
        raise DocumentError(f"it is not a CSV file: {error}") from error
    return rows


def _check_names(names: Sequence[str]) -> None:
    """Raise if a column has the name of another one."""
    seen: set[str] = set()
    for name in filter(None, names):
        if name in seen:
            raise DocumentError(f"the column {name!r} comes twice")
        seen.add(name)
