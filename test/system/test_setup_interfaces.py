"""ROS interfaces that the set-up builds: their cache, and what is generated for whom."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from repository import REPOSITORY

from tools.setup.cache import MAX_ENTRIES, cache_folder, read_entry, write_entry
from tools.setup.interfaces import colcon_progress, pack, unpack

PREFIX = Path(sys.prefix)


def test_an_entry_of_the_cache_is_read_back(tmp_path: Path) -> None:
    assert read_entry(tmp_path, "key") is None
    write_entry(tmp_path, "key", b"content" * 1000)
    assert read_entry(tmp_path, "key") == b"content" * 1000
    assert read_entry(tmp_path, "other") is None
    assert [file.name for file in tmp_path.iterdir()] == ["key.tar.gz"]


@pytest.mark.parametrize("damage", ["cut", "changed", "empty"])
def test_a_damaged_entry_is_not_used(tmp_path: Path, damage: str) -> None:
    write_entry(tmp_path, "key", os.urandom(10_000))
    entry = tmp_path / "key.tar.gz"
    content = bytearray(entry.read_bytes())
    content[5_000] ^= 1
    damaged = {"cut": content[:4_000], "changed": content, "empty": bytearray()}
    entry.write_bytes(damaged[damage])
    assert read_entry(tmp_path, "key") is None
    write_entry(tmp_path, "key", b"new")
    assert read_entry(tmp_path, "key") == b"new"


def test_the_cache_keeps_what_was_used_last(tmp_path: Path) -> None:
    for index in range(MAX_ENTRIES):
        write_entry(tmp_path, str(index), b"content")
        os.utime(tmp_path / f"{index}.tar.gz", (index, index))
    assert read_entry(tmp_path, "0") == b"content"
    write_entry(tmp_path, "new", b"content")
    kept = {file.name.removesuffix(".tar.gz") for file in tmp_path.iterdir()}
    assert kept == {"0", "new", *map(str, range(2, MAX_ENTRIES))}


def test_a_cache_that_cannot_be_written_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_entry(tmp_path / "not there", "key", b"content")
    assert not (tmp_path / "not there").exists()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("OAISYS_CACHE_MB", raising=False)
    assert cache_folder() == tmp_path / "oaisys" / "interfaces"
    monkeypatch.setenv("OAISYS_CACHE_MB", "0")
    assert cache_folder() is None
    monkeypatch.delenv("OAISYS_CACHE_MB")
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert cache_folder() is None


def installed(folder: Path, files: dict[str, bytes]) -> Path:
    for name, content in files.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
    return folder


def test_an_archive_fits_another_environment(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    stage = first / "oaisys" / "stage"
    files = {
        "share/setup.sh": f"{stage}:{first}\n".encode(),
        "lib/a.so": b"\0" + bytes(first),
        "lib/__pycache__/a.pyc": b"",
    }
    installed(stage, files)
    (stage / "share" / "setup.sh").chmod(0o755)
    unpack(pack(stage, first), second, tmp_path / "names")

    assert (second / "share" / "setup.sh").read_text() == f"{second}:{second}\n"
    assert (second / "share" / "setup.sh").stat().st_mode & 0o777 == 0o755
    assert (second / "lib" / "a.so").read_bytes() == b"\0" + bytes(first)
    assert not (second / "lib" / "__pycache__").exists()


def test_a_renamed_message_leaves_nothing_behind(tmp_path: Path) -> None:
    names, prefix = tmp_path / "names", tmp_path / "prefix"
    files = {"share/Old.msg": b"", "share/Same.msg": b"old", "share/0.1.egg-info/PKG-INFO": b""}
    old = installed(tmp_path / "old", files)
    new = installed(tmp_path / "new", {"share/New.msg": b"", "share/Same.msg": b"new"})
    unpack(pack(old, prefix), prefix, names)
    installed(prefix, {"share/wheel.cmake": b""})
    unpack(pack(new, prefix), prefix, names)

    found = {file.name for file in (prefix / "share").iterdir()}
    assert found == {"New.msg", "Same.msg", "wheel.cmake"}
    assert (prefix / "share" / "Same.msg").read_bytes() == b"new"


def test_an_interrupted_copy_is_completed_by_the_next(tmp_path: Path) -> None:
    """A folder stands where a file should: the copy fails after the first file."""
    names, prefix = tmp_path / "names", tmp_path / "prefix"
    first = installed(tmp_path / "first", {"a": b"", "b": b""})
    (prefix / "b").mkdir(parents=True)
    with pytest.raises(OSError, match="b"):
        unpack(pack(first, prefix), prefix, names)
    assert (prefix / "a").is_file()
    (prefix / "b").rmdir()
    second = installed(tmp_path / "second", {"c": b""})
    unpack(pack(second, prefix), prefix, names)
    assert [file.name for file in prefix.iterdir() if not file.name.startswith(".")] == ["c"]


def test_progress_counts_packages_and_the_share_that_is_compiled(tmp_path: Path) -> None:
    for name, said in (("a", "[ 50%] A\n[100%] B\n"), ("b", "[  7%] A\n[ 40%] B\n"), ("c", "--\n")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "stdout.log").write_text(said)
    progress = colcon_progress("Starting >>> a\nFinished <<< a [1s]\n", 3, tmp_path)
    assert progress.text == "1 of 3 packages built, 47 % compiled"
    assert progress.share == pytest.approx(1.4 / 3)


def test_no_interface_of_the_environment_is_built_for_another_one() -> None:
    names = (PREFIX / "oaisys" / "interfaces.txt").read_text().splitlines()
    assert "share/oaisys_msgs/package.xml" in names
    texts = [content for name in names if b"\0" not in (content := (PREFIX / name).read_bytes())]
    assert not [text for text in texts if b"@OAISYS_PREFIX@" in text or b"oaisys/stage" in text]
    assert any(bytes(PREFIX) in text for text in texts)


@pytest.mark.parametrize(
    "package",
    [
        "grid_map_msgs",
        "oaisys_msgs",
        "simulation_interfaces",
        "stereo_msgs",
        "tf2_msgs",
        "vision_msgs",
    ],
)
def test_interfaces_have_what_the_middleware_loads(package: str) -> None:
    """rmw_fastrtps registers a type by its introspection; rmw_cyclonedds needs nothing else."""
    for support in ("c", "fastrtps_c", "introspection_c"):
        assert (PREFIX / "lib" / f"lib{package}__rosidl_typesupport_{support}.so").is_file()


@pytest.mark.long
def test_a_users_own_build_has_messages_for_cpp(tmp_path: Path) -> None:
    """What the set-up leaves out is left out of its own builds only."""
    shutil.copytree(REPOSITORY / "oaisys_msgs", tmp_path / "oaisys_msgs")
    recipe, build = tmp_path / "oaisys_msgs" / "CMakeLists.txt", tmp_path / "build"
    interface = re.compile(r'^ +"(?!srv/SetPose)(?:action|msg|srv)/.*\n', re.MULTILINE)
    recipe.write_text(interface.sub("", recipe.read_text()))  # one stands for all
    for command in (
        ["cmake", "-S", str(tmp_path / "oaisys_msgs"), "-B", str(build), "-DBUILD_TESTING=OFF"],
        ["cmake", "--build", str(build), "--target", "oaisys_msgs__cpp"],
    ):
        subprocess.run(command, check=True, timeout=300)
    headers = build / "rosidl_generator_cpp" / "oaisys_msgs" / "srv"
    assert (headers / "set_pose.hpp").is_file()
    rules = (build / "Makefile").read_text()
    assert "oaisys_msgs__rosidl_typesupport_fastrtps_cpp" in rules
    assert "oaisys_msgs__rosidl_typesupport_introspection_cpp" in rules
