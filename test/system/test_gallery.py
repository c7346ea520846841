"""The gallery: all example worlds and texture sets, or those whose names contain a text."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from repository import REPOSITORY

from oaisys_core.procedural.textures import TEXTURES
from tools.gallery.gallery import EXAMPLES
from tools.gallery.scenes import TARGET_GROUP, pictures


def test_all_of_them_are_chosen_without_a_name() -> None:
    chosen = list(pictures(EXAMPLES, "", "analytic", "draft"))
    examples = [each for each in chosen if each.group != TARGET_GROUP]
    assert len(examples) == len(list(EXAMPLES.glob("*.yaml"))) > 60
    assert {each.name for each in chosen if each.group == TARGET_GROUP} == set(TEXTURES)


def test_a_part_of_a_name_is_no_pattern() -> None:
    assert [each.name for each in pictures(EXAMPLES, "age_mesa", "analytic", "draft")] == ["mesa"]
    for text in ("*", "[", "?", "stage*"):
        assert list(pictures(EXAMPLES, text, "analytic", "draft")) == []


@pytest.mark.parametrize("text", [pytest.param("**", marks=pytest.mark.soak), "no such world"])
def test_a_text_that_is_in_no_name_is_refused(tmp_path: Path, text: str) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "tools.gallery", "--out", str(out), "--only", text]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert repr(text) in done.stderr
    assert "Traceback" not in done.stderr
    assert not out.exists()
