"""Where files are written: never over a device, never through somebody else's link."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest
from commands import oaisys_here

from oaisys_core.errors import InvalidInputError, RenderError
from oaisys_core.files.folders import user_path
from oaisys_core.files.whole_files import check_output_file, whole_file, whole_folder
from oaisys_core.output.files import write_text
from oaisys_dataset.places import open_place


def test_no_file_replaces_a_device_or_a_pipe(tmp_path: Path) -> None:
    """`--out /dev/null`, as root, made a regular file of /dev/null."""
    pipe, device = tmp_path / "pipe.json", tmp_path / "device.json"
    os.mkfifo(pipe)
    device.symlink_to("/dev/null")
    for path in (pipe, device):
        with pytest.raises(RenderError, match="no regular file"):
            write_text(path, "{}")
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert device.is_symlink()
    assert sorted(tmp_path.iterdir()) == [device, pipe]


def test_a_command_says_that_its_output_is_no_file(tmp_path: Path) -> None:
    pipe = tmp_path / "heights.tif"
    os.mkfifo(pipe)
    config = tmp_path / "world.yaml"
    stage = "{extent_m: 10, resolution_px: 33}"
    config.write_text(f"backend: analytic\nstage: {stage}\nassets: {{rocks: []}}\n")
    done = oaisys_here("heights", "--config", config, "--out", pipe)
    assert done.returncode == 2
    assert "out: received" in done.stderr
    assert "no regular file" in done.stderr
    assert "Traceback" not in done.stderr


def test_an_output_that_cannot_be_is_refused_before_the_work(tmp_path: Path) -> None:
    """`audit --out FOLDER` was refused after all views had been rendered."""
    file = tmp_path / "file"
    file.touch()
    for path in (tmp_path, file / "x.json", Path()):
        with pytest.raises(InvalidInputError, match="figures: received"):
            check_output_file(path, "figures")
    assert check_output_file(tmp_path / "new" / "x.json") == tmp_path / "new" / "x.json"
    assert not list((tmp_path / "new").iterdir())
    for command in (["audit"], ["audit", "--light"], ["config", "schema"]):
        done = oaisys_here(*command, "--out", tmp_path)
        assert done.returncode == 2, done.stderr
        assert "no regular file" in done.stderr


def test_a_path_without_a_name_is_refused() -> None:
    """The temporary file of an empty path had no name: a bare ValueError."""
    with pytest.raises(InvalidInputError, match="the name of a file"), whole_file(Path()):
        pass
    with pytest.raises(InvalidInputError, match="the name of a folder"), whole_folder(Path()):
        pass
    with pytest.raises(InvalidInputError, match="path: received ''"):
        user_path("", "path")


def test_a_link_under_the_temporary_name_is_not_followed(tmp_path: Path) -> None:
    """The name can be foreseen, so another user may put a link there."""
    victim, path = tmp_path / "victim", tmp_path / "out.json"
    victim.mkdir()
    (victim / ".part-out.json").write_text("precious")
    (tmp_path / ".out.json.part").symlink_to(victim)
    (tmp_path / ".out.part.json").symlink_to(victim / ".part-out.json")
    write_text(path, "{}")
    assert (victim / ".part-out.json").read_text() == "precious"
    assert path.read_text() == "{}"


def test_a_folder_of_a_data_set_that_is_a_link_is_not_written_to(tmp_path: Path) -> None:
    victim, dataset = tmp_path / "victim", tmp_path / "set"
    victim.mkdir()
    dataset.mkdir()
    (dataset / "card").symlink_to(victim)
    with pytest.raises(RenderError, match="card is a link"):
        open_place(dataset).write("card/picture.png", b"1")
    assert not list(victim.iterdir())
