"""The folder of texture sets: whole, bounded, shared, and never a reason to fail."""

import os
import subprocess
import sys
import time
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from oaisys_core.procedural.textures import cache, default_cache_dir, library, texture_set
from oaisys_core.scene import PbrMaps

SIZE = 32


def same(first: PbrMaps, second: PbrMaps) -> bool:
    return all(
        np.array_equal(getattr(first, f.name), getattr(second, f.name)) for f in fields(PbrMaps)
    )


def entry(folder: Path) -> Path:
    (path,) = folder.glob("*.npz")
    return path


def refuse_to_make(name: str, size_px: int, seed: int) -> PbrMaps:
    raise AssertionError("made again")


def test_a_hit_gives_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = texture_set("sand", SIZE, 0, tmp_path)
    monkeypatch.setattr(library, "make_texture_set", refuse_to_make)
    assert same(texture_set("sand", SIZE, 0, tmp_path), made)
    with pytest.raises(AssertionError, match="made again"):
        texture_set("sand", SIZE, 1, tmp_path)


def damages() -> list[tuple[str, float]]:
    """Bytes that are wrong or missing: which, and from which share of the file on."""
    return [("cut", share) for share in (0.0, 0.01, 0.5, 0.999)] + [
        ("flipped", share) for share in (0.0, 0.2, 0.5, 0.8, 0.99)
    ]


@pytest.mark.parametrize(("kind", "share"), damages())
def test_a_damaged_entry_is_made_again(tmp_path: Path, kind: str, share: float) -> None:
    made = texture_set("sand", SIZE, 0, tmp_path)
    path = entry(tmp_path)
    whole = path.read_bytes()
    at = int(share * len(whole))
    flipped = whole[:at] + bytes(b ^ 0xFF for b in whole[at : at + 40]) + whole[at + 40 :]
    path.write_bytes(whole[:at] if kind == "cut" else flipped)
    assert same(texture_set("sand", SIZE, 0, tmp_path), made)
    assert path.read_bytes() == whole


def test_a_whole_file_of_something_else_is_made_again(tmp_path: Path) -> None:
    made = texture_set("sand", SIZE, 0, tmp_path)
    path = entry(tmp_path)
    np.savez(path, **{kind: np.zeros((3, 3)) for kind in cache.KINDS}, tile_m=np.array(1.0))
    assert same(texture_set("sand", SIZE, 0, tmp_path), made)
    path.write_bytes(b"\x93NUMPY no archive")
    assert same(texture_set("sand", SIZE, 0, tmp_path), made)


def test_it_stays_within_its_bound_and_keeps_what_was_used_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    texture_set("sand", SIZE, 0, tmp_path)
    size = entry(tmp_path).stat().st_size
    monkeypatch.setenv(cache.LIMIT_VARIABLE, str(3.5 * size / 1e6))
    for seed in (1, 2):
        texture_set("sand", SIZE, seed, tmp_path)
    for age, path in enumerate(sorted(tmp_path.glob("*.npz"), key=lambda p: p.stat().st_mtime_ns)):
        os.utime(path, (age, age))
    before = set(tmp_path.iterdir())
    texture_set("sand", SIZE, 0, tmp_path)
    texture_set("sand", SIZE, 3, tmp_path)
    after = set(tmp_path.iterdir())
    assert len(after) == 3
    assert sum(path.stat().st_size for path in after) <= 3.5 * size
    # Seed 1 was not used since; seed 0 was, though it was the first to be written.
    monkeypatch.setattr(library, "make_texture_set", refuse_to_make)
    texture_set("sand", SIZE, 0, tmp_path)
    assert len(before & after) == 2


def test_what_broken_writers_left_goes(tmp_path: Path) -> None:
    old, new = tmp_path / "old.tmp", tmp_path / "new.tmp"
    for path in (old, new):
        path.write_bytes(b"part")
    hours_ago_s = time.time() - 3 * 3600
    os.utime(old, (hours_ago_s, hours_ago_s))
    texture_set("sand", SIZE, 0, tmp_path)
    assert not old.exists()
    assert new.exists(), "another process may be writing it"


def test_it_can_be_turned_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv(cache.LIMIT_VARIABLE, "0")
    assert default_cache_dir() is None
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setenv(cache.LIMIT_VARIABLE, "much")
    assert default_cache_dir() is not None


WRITER = """
import sys
from pathlib import Path
from oaisys_core.procedural.textures import texture_set
from oaisys_core.procedural.textures import cache

folder, out = Path(sys.argv[1]), Path(sys.argv[2])
for turn in range(8):
    maps = texture_set("sand", 32, 0, folder)
    cache.write(next(folder.glob("*.npz")), maps)
out.write_bytes(maps.color_srgb.tobytes() + maps.height.tobytes())
"""


def test_processes_share_it(tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    folder.mkdir()
    outs = [tmp_path / str(number) for number in range(3)]
    writers = [
        subprocess.Popen([sys.executable, "-c", WRITER, folder, out], stderr=subprocess.PIPE)
        for out in outs
    ]
    for writer in writers:
        _, errors = writer.communicate(timeout=60)
        assert writer.returncode == 0, errors.decode()
        assert b"not readable" not in errors
    made = library.make_texture_set("sand", 32, 0)
    expected = made.color_srgb.tobytes() + made.height.tobytes()
    assert [out.read_bytes() for out in outs] == [expected] * 3
    assert [path.suffix for path in folder.iterdir()] == [".npz"]
