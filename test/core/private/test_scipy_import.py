"""SciPy imported without its parser of docstrings."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from oaisys_core.private.scipy_import import PARSED, PARSER, KeptDocstring, SciPyGuard, guard_scipy

USE = """
import inspect
import oaisys_core
import scipy.ndimage, scipy.spatial.transform, scipy.stats
from scipy._lib import _docscrape
assert _docscrape.FunctionDoc.__module__ == "oaisys_core.private.scipy_import"
assert _docscrape.__file__.endswith("_docscrape.py")
for function in scipy.ndimage.zoom, scipy.linalg.det, scipy.stats.kurtosis:
    assert "Parameters\\n" in function.__doc__ and "Array API" not in function.__doc__
assert scipy.ndimage.zoom([1.0, 2.0], 2, order=1).shape == (4,)
assert {"axis", "nan_policy", "keepdims"} <= set(inspect.signature(scipy.stats.skew).parameters)
assert scipy.stats.skew([[1.0, 2.0, 9.0]], axis=1, keepdims=True).shape == (1, 1)
"""


def test_functions_keep_their_docstrings_and_do_what_they_did() -> None:
    ended = subprocess.run(
        [sys.executable, "-c", USE], capture_output=True, text=True, timeout=120, check=False
    )
    assert ended.returncode == 0, ended.stderr


def test_what_is_added_to_a_docstring_is_left_out() -> None:
    docstring = KeptDocstring(test_what_is_added_to_a_docstring_is_left_out)
    docstring["Notes"].append("added")
    docstring["Parameters"] = ["x"]
    assert docstring["Parameters"] == ["x"]
    assert str(KeptDocstring(lambda: None)) == "\n"


@pytest.mark.parametrize(("text", "lines"), [("class FunctionDoc: ...", 0), ("", 1)])
def test_a_parser_without_that_class_stays_as_it_is(
    text: str, lines: int, tmp_path: Path, fallback_lines: Callable[[], list[str]]
) -> None:
    (tmp_path / "_docscrape.py").write_text(text, encoding="ascii")
    found = SciPyGuard().find_spec(PARSER, [str(tmp_path)])
    assert found is not None
    assert found.loader is not None
    module = ModuleType(PARSER)
    found.loader.exec_module(module)
    assert getattr(module, PARSED, None) is (None if lines else KeptDocstring)
    assert len(fallback_lines()) == lines


def test_the_hook_finds_nothing_else(tmp_path: Path) -> None:
    assert SciPyGuard().find_spec("scipy.ndimage", None) is None
    assert SciPyGuard().find_spec(PARSER, [str(tmp_path)]) is None
    guard_scipy()
    assert sum(isinstance(finder, SciPyGuard) for finder in sys.meta_path) == 1
