"""What lies in the current folder is not loaded by the libraries of this project."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from oaisys_core.system.current_folder import in_root_folder


def test_the_current_folder_is_another_one_within_the_block_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileNotFoundError), in_root_folder():
        (Path.cwd() / "no such file").read_text()
    assert Path.cwd() == tmp_path
    with in_root_folder():
        assert Path.cwd() == Path("/")
    tmp_path.joinpath("gone").mkdir()
    os.chdir("gone")
    tmp_path.joinpath("gone").rmdir()
    with in_root_folder():
        pass


@pytest.mark.blender
def test_blender_loads_no_library_of_the_current_folder(tmp_path: Path) -> None:
    """Its library for sound runs each library in the folder ``plugins`` there."""
    library = next(Path(np.__file__).parent.rglob("*.so"))
    plugins = tmp_path / "plugins"
    plugins.mkdir()
    shutil.copy(library, plugins / "planted.so")

    def loaded(module: str) -> bool:
        code = f"import os, {module}; os._exit(0)"
        environment = {**os.environ, "LD_DEBUG": "files"}
        command = [sys.executable, "-P", "-c", code]
        ended = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        )
        return "plugins/planted.so" in ended.stderr

    assert loaded("bpy"), "Blender itself does"
    assert not loaded("oaisys_core.render.blender.renderer")
