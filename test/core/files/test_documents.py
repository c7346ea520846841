"""Hostile YAML, JSON and CSV: refused in a moment, with one sentence."""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import pytest
import yaml

from oaisys_core.cli.rendering.metadata_file import load_steps
from oaisys_core.config import load_config
from oaisys_core.errors import ConfigError, InvalidInputError, quote
from oaisys_core.files.calibrations import read_calibration
from oaisys_core.files.csv_tables import read_csv
from oaisys_core.files.documents import (
    LONGEST_WHOLE,
    MAX_DEPTH,
    MAX_TEXT_BYTES,
    DocumentError,
    parse_json,
    read_text,
)
from oaisys_core.files.poses import read_pose_table
from oaisys_core.files.yaml_documents import parse_yaml, yaml_comments
from oaisys_mapping.certificate.light_audit import read_light_audit

LAUGHS = "a0: &a0 [lol]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 10)
)
MERGED_LAUGHS = "a0: &a0 {k: 1}\n" + "".join(
    f"a{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * 10)}]}}\n" for n in range(1, 10)
)
CHAIN = "a0: &a0 [1]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}]\n" for n in range(1, 2000))
HOSTILE = {
    "aliases": LAUGHS,
    "merge keys": MERGED_LAUGHS,
    "a chain of aliases": CHAIN,
    "a circle": "seed: &a [*a]\n",
    "a circle of merges": "a: &a\n  <<: *a\n",
    "brackets": "[" * 20_000,
    "nested keys": "".join(f"{' ' * n}a:\n" for n in range(1000)),
    "digits": "seed: " + "1" * 100_000,
    "base 60": "seed: 1" + ":59" * 300_000,
    "a date that is none": "seed: 2001-99-99",
    "its size": "# " + "x" * MAX_TEXT_BYTES,
}


@pytest.mark.timeout(60)
@pytest.mark.parametrize("what", HOSTILE)
def test_hostile_yaml_is_refused_at_once(tmp_path: Path, what: str) -> None:
    file = tmp_path / "world.yaml"
    file.write_text(HOSTILE[what])
    with pytest.raises(ConfigError) as refused:
        load_config(file)
    assert len(str(refused.value)) < 1000
    with pytest.raises(InvalidInputError):
        load_steps(file)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a: 1\nseed: !!bool abc\n", "line 2: received 'abc', expected what '!!bool' may be"),
        ("seed: !!timestamp x\n", "received 'x', expected what '!!timestamp' may be"),
        ("- !!timestamp 99999-99-99\n", "received '99999-99-99'"),
        ('seed: !!int ""\n', "line 1: received '', expected what '!!int' may be"),
        ('<<: {b: 2}\na: [!!float ""]\n', "expected what '!!float' may be"),
        ("!!bool abc: 1\n", "received 'abc', expected what '!!bool' may be"),
        ("a: !!int abc\n", "abc"),
    ],
)
def test_a_text_that_its_tag_does_not_fit_is_refused(text: str, told: str) -> None:
    with pytest.raises(DocumentError) as refused:
        parse_yaml(text)
    assert told in str(refused.value)


REPEATED = {
    "a section": ("assets: {}\nstage: {}\nassets: {}\n", "'assets' stands twice, on lines 1 and 3"),
    "in a list": ("a:\n- b: 1\n  c: 2\n  b: 1\n", "'b' stands twice, on lines 2 and 4"),
    "in quotes": ('"a": 1\na: 2\n', "'a' stands twice, on lines 1 and 2"),
    "on one line": ("a: {b: 1, b: 2}\n", "'b' stands twice, on line 1"),
    "merges": ("a: &a {x: 1}\nb:\n  <<: *a\n  <<: *a\n", "'<<' stands twice, on lines 3 and 4"),
    "behind an alias": ("a: &a {x: 1, x: 2}\nb: *a\n", "'x' stands twice, on line 1"),
}


@pytest.mark.parametrize(("text", "told"), REPEATED.values(), ids=REPEATED)
def test_a_key_that_stands_twice_is_refused_with_its_lines(
    tmp_path: Path, text: str, told: str
) -> None:
    """The last one won: a whole section vanished."""
    with pytest.raises(DocumentError, match=told):
        parse_yaml(text)
    file = tmp_path / "world.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=told):
        load_config(file)


def test_a_key_that_stands_twice_in_json_is_refused() -> None:
    with pytest.raises(ValueError, match="'b' stands there twice"):
        parse_json('{"a": [{"b": 1, "b": 1}]}')


@pytest.mark.parametrize(
    "number",
    [
        *("010", "-07", "08", "0_1", "0b11", "0o17", "-0x1F", "0x1_F", "12:30", "1:30:00.5"),
        *("1_000", "1_000.5", ".5_0"),
    ],
)
def test_numbers_that_versions_of_yaml_read_differently_are_refused(number: str) -> None:
    with pytest.raises(DocumentError, match="line 1: received"):
        parse_yaml(f"seed: {number}\n")
    assert parse_yaml(f"seed: '{number}'\n") == {"seed": number}


def test_ordinary_numbers_are_read() -> None:
    text = "[0, -1, 10, 0.5, 00.5, 0x10, 1.5e+3]"
    assert parse_yaml(text) == [0, -1, 10, 0.5, 0.5, 16, 1500.0]
    texts = "[00:11:22, 10:99, 2026_a, _1, 09a, 0b2, 1.2.3, !!str 010]"
    assert parse_yaml(texts) == texts.strip("[]").replace("!!str ", "").split(", ")


def _number_of_yaml_1_2(text: str) -> object:
    """Return what the core schema of YAML 1.2, 10.3.2, makes of a plain text."""
    if re.fullmatch("[-+]?[0-9]+", text):
        return int(text)
    if re.fullmatch("0o[0-7]+|0x[0-9a-fA-F]+", text):
        return int(text, 0)
    is_float = re.fullmatch(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", text)
    return float(text) if is_float else text


def test_all_short_numbers_are_read_as_both_versions_of_yaml_do_or_refused() -> None:
    """PyYAML itself reads YAML 1.1."""
    for length in range(1, 5):
        for letters in product("0178_:.-xboe", repeat=length):
            text = "".join(letters)
            if not is_plain_scalar(text):
                continue
            try:
                found = parse_yaml(text)
            except DocumentError:
                leading_zeros = re.fullmatch("[-+]?0[0-7]+", text)
                assert leading_zeros or yaml_1_1(text) != _number_of_yaml_1_2(text), text
            else:
                read = float(found) if _is_float_as_text(text, found) else found
                assert read == _number_of_yaml_1_2(text), text


def is_plain_scalar(text: str) -> bool:
    try:
        node = yaml.compose(text)
    except yaml.YAMLError:
        return False
    return isinstance(node, yaml.ScalarNode) and node.value == text


def yaml_1_1(text: str) -> object:
    try:
        return yaml.safe_load(text)
    except ValueError:  # such as 0b_
        return None


def _is_float_as_text(text: str, found: object) -> bool:
    """Return whether it is text as in YAML 1.1, which counts where a number is expected."""
    return found == text and isinstance(_number_of_yaml_1_2(text), float)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a: 1\nb: 2026-13-45T99:00:00+02:00\n", "line 2: received '2026-13-45T99:00:00+02:00'"),
        ("- 2026-02-30\n", "line 1: received '2026-02-30', expected a date and time that exist"),
        ("a: {2026-00-01: 1}\n", "line 1: received '2026-00-01'"),
        ("2026-01-01T00:00:00+99:00", "line 1: received '2026-01-01T00:00:00+99:00'"),
        ("\n- !!int abc\n", "line 2: received 'abc', expected what '!!int' may be"),
        ("- !!float abc\n", "line 1: received 'abc', expected what '!!float' may be"),
    ],
)
def test_a_date_or_number_that_there_is_not_is_refused_by_line_and_text(
    text: str, told: str
) -> None:
    with pytest.raises(DocumentError) as refused:
        parse_yaml(text)
    assert told in str(refused.value)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be", "utf-32", "utf-32-be"])
def test_an_encoding_that_is_not_read_is_named(tmp_path: Path, encoding: str) -> None:
    mark = "" if encoding in ("utf-16", "utf-32") else "\ufeff"
    file = tmp_path / "world.yaml"
    file.write_bytes((mark + "seed: 3\n").encode(encoding))
    with pytest.raises(DocumentError, match=f"in {encoding[:6].upper()}, expected UTF-8"):
        read_text(file)


def test_ordinary_aliases_and_merges_are_replaced() -> None:
    text = "a: &a {x: 1, y: 2}\nb: {<<: *a, y: 3}\nc: [*a, *a]\n"
    assert parse_yaml(text) == {
        "a": {"x": 1, "y": 2},
        "b": {"x": 1, "y": 3},
        "c": [{"x": 1, "y": 2}] * 2,
    }


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, '{"a":' * 10_000 + "1" + "}" * 10_000, "[" * 200 + "]" * 200],
    ids=["open", "objects", "lists"],
)
def test_nested_json_is_refused(text: str) -> None:
    with pytest.raises(DocumentError, match=f"nested more than {MAX_DEPTH} times"):
        parse_json(text)


def test_long_numbers_in_json_are_refused() -> None:
    with pytest.raises(ValueError, match="it: received 100000 digits"):
        parse_json("1" * 100_000)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ("seed: 4".encode("utf-16"), "in UTF-16, expected UTF-8"),
        (b"# caf\xe9", "not text in UTF-8: byte 0xe9 at position 5"),
    ],
)
def test_another_encoding_is_named(tmp_path: Path, data: bytes, expected: str) -> None:
    """It was said in words of Python's decoder."""
    (tmp_path / "text").write_bytes(data)
    with pytest.raises(DocumentError, match=expected):
        read_text(tmp_path / "text")


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(DocumentError, match="regular file"):
        read_text(tmp_path / "pipe.yaml")


def test_rows_beyond_the_most_are_refused_before_they_are_read(tmp_path: Path) -> None:
    file = tmp_path / "poses.csv"
    file.write_text("x_m,y_m\n" + "1,2\n" * 11)
    assert len(read_csv(file, 11)) == 11
    with pytest.raises(DocumentError, match="more than 10 rows"):
        read_csv(file, 10)
    with file.open("wb") as sparse:
        sparse.truncate(10**11)
    with pytest.raises(DocumentError, match="100000000000 bytes"):
        read_csv(file, 10)


@pytest.mark.parametrize(
    "value",
    [1, "text", (1,), [1, (2, "x")], {"a": {"b": [None]}}, 1.5, b"bytes", [], (), {}, True],
)
def test_short_values_are_quoted_whole(value: Any) -> None:
    assert quote(value) == repr(value)


def nested(depth: int) -> list[Any]:
    value: list[Any] = []
    for _ in range(depth):
        value = [value]
    return value


def shared(levels: int) -> list[Any]:
    value: list[Any] = ["lol"]
    for _ in range(levels):
        value = [value] * 10
    return value


LONG = {
    "text": "x" * 10**7,
    "a number": 10**100_000,
    "nested lists": nested(100_000),
    "a list repeated": shared(30),
    "a key": {"k" * 10**6: 1},
    "bytes": b"x" * 10**6,
}


@pytest.mark.timeout(20)
@pytest.mark.parametrize("value", LONG.values(), ids=LONG)
def test_of_long_values_errors_show_the_beginning(value: Any) -> None:
    message = str(InvalidInputError("field", value, "another"))
    assert len(message) < 80 + len("field: received , expected another") + 1


def test_of_a_long_path_errors_show_the_file() -> None:
    shown = quote("/data/" + "folder/" * 30 + "stage.obj")
    assert len(shown) <= 80
    assert shown.startswith("'/data/")
    assert shown.endswith("stage.obj'")


def test_no_character_ends_a_comment() -> None:
    # Letters, and what has no meaning yet, are a million more of a few kinds.
    plain = {"Lo", "Cn", "Co", "Cs"}
    some = [n for n in range(0x110000) if n % 97 == 0 or unicodedata.category(chr(n)) not in plain]
    text = yaml_comments(["".join(f"{chr(number)}seed: 666" for number in some)])
    assert len(text.splitlines()) == 1
    assert yaml.safe_load(text.encode("utf-8")) is None


@pytest.mark.parametrize("digits", ["9" * 390, "-" + "9" * 310, "1" + "0" * 309])
def test_whole_numbers_that_no_float_can_be_are_refused(digits: str) -> None:
    with pytest.raises(DocumentError, match=r"a\.1: received 3\d\d digits, '-?[91]") as refused:
        parse_json(f'{{"a": [1, {digits}]}}')
    assert len(str(refused.value)) < 200
    with pytest.raises(DocumentError, match=r"a\.1: received 3\d\d digits"):
        parse_json(f'{{"a": [1, {digits}]}}'.encode("utf-16"))
    with pytest.raises(DocumentError, match=r"line 2: '-?[91].*, expected at most 256 digits"):
        parse_yaml(f"a:\n- {digits}\n")
    with pytest.raises(DocumentError, match="line 1: '0xf"):
        parse_yaml("a: 0x" + "f" * 256)


def test_the_largest_whole_numbers_are_floats() -> None:
    largest = "9" * LONGEST_WHOLE
    assert float(parse_yaml(largest)) == float(parse_json(largest)) == 1e256
    assert parse_json("9" * 308) == int("9" * 308)
    assert parse_yaml("9." + "9" * 300) == 10.0


NINES = "9" * 390
READERS: dict[str, tuple[Callable[[Path], object], str]] = {
    "transforms.json": (
        read_pose_table,
        f'{{"frames": [{{"transform_matrix": [[{NINES}, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}}]}}',
    ),
    "ros.yaml": (
        read_calibration,
        (
            "image_width: 64\nimage_height: 48\ndistortion_model: plumb_bob\n"
            f"camera_matrix: {{rows: 3, cols: 3, data: [{NINES}, 0, 32, 0, 60, 24, 0, 0, 1]}}\n"
        ),
    ),
    "camchain.yaml": (
        read_calibration,
        (
            "cam0:\n  camera_model: pinhole\n  distortion_model: radtan\n  resolution: [64, 48]\n"
            f"  distortion_coeffs: [0, 0, 0, 0]\n  intrinsics: [{NINES}, 60, 32, 24]\n"
        ),
    ),
    "sensor.yaml": (
        read_calibration,
        f"sensor_type: camera\nT_BS: {{rows: 4, cols: 4, data: [{NINES}, 0, 0, 0]}}\n",
    ),
    "light.json": (
        read_light_audit,
        f'[{{"backend": "a", "backend_version": "1", "name": "b", "expected": {NINES}}}]',
    ),
}


@pytest.mark.parametrize("name", READERS)
def test_readers_refuse_numbers_of_hundreds_of_digits(tmp_path: Path, name: str) -> None:
    read, text = READERS[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(InvalidInputError, match=r"expected (a whole|at most 256 digits)"):
        read(tmp_path / name)
