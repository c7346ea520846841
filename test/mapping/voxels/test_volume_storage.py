"""A volume's memory limit, its disk store and its files."""

import hashlib
import time
from pathlib import Path

import numpy as np
import pytest
from synthetic_views import (
    CAMERA,
    UP,
    camera_at,
    flight,
    fly,
    plane_depth_m,
    same_mesh,
)

from oaisys_core.errors import InvalidInputError
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume, VolumeFullError

ABOVE = camera_at((0.01, 0, 6), (0, 0, 0))
GROUND_M = plane_depth_m(ABOVE, UP, 0.0)


@pytest.mark.parametrize("when_full", ["drop", "store"])
def test_memory_is_bounded_wherever_the_camera_goes(when_full: str, tmp_path: Path) -> None:
    limited = TsdfVolume(TsdfConfig(max_blocks=600, when_full=when_full, store_folder=tmp_path))
    free = TsdfVolume()
    for T in flight(12):
        for volume in (limited, free):
            fly(volume, [T])
        assert limited.blocks_in_memory <= 600
    assert free.blocks_in_memory > 1500
    assert list(tmp_path.iterdir()) == []
    reach_m = {
        name: volume.extract_mesh().vertices_m[:, 0]
        for name, volume in (("limited", limited), ("free", free))
    }
    assert reach_m["limited"].max() == pytest.approx(reach_m["free"].max())
    if when_full == "drop":
        assert limited.blocks_stored == 0
        assert reach_m["limited"].min() > 10
    else:
        assert limited.blocks_stored > 900
        assert same_mesh(limited.extract_mesh(), free.extract_mesh())
        near = limited.extract_mesh(with_stored=False)
        assert 0 < len(near.triangles) < 0.7 * len(free.extract_mesh().triangles)


def test_stored_blocks_come_back_with_the_camera(tmp_path: Path) -> None:
    there_and_back = [*flight(10), *flight(10)[::-1]]
    limited = TsdfVolume(TsdfConfig(max_blocks=600, when_full="store", semantic=True))
    free = TsdfVolume(TsdfConfig(semantic=True))
    fly(limited, there_and_back)
    fly(free, there_and_back)
    assert same_mesh(limited.extract_mesh(), free.extract_mesh())
    assert limited.blocks_in_memory + limited.blocks_stored == free.blocks_in_memory
    limited.save(tmp_path / "limited.npz")
    free.save(tmp_path / "free.npz")
    assert (tmp_path / "limited.npz").read_bytes() == (tmp_path / "free.npz").read_bytes()


@pytest.mark.parametrize("when_full", ["refuse", "drop", "store"])
def test_a_view_larger_than_the_volume_is_refused(when_full: str) -> None:
    volume = TsdfVolume(TsdfConfig(max_blocks=20, when_full=when_full))
    with pytest.raises(VolumeFullError, match="20 may be used"):
        volume.integrate(GROUND_M, None, CAMERA, ABOVE)
    assert volume.is_empty


def test_equal_views_give_equal_files_at_any_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    digests = []
    now_s = time.time()
    for name, later_s in (("one.npz", 0.0), ("two.npz", 3600.0)):
        monkeypatch.setattr(time, "time", lambda later_s=later_s: now_s + later_s)
        volume = fly(TsdfVolume(TsdfConfig(semantic=True)), flight(3))
        volume.save(tmp_path / name)
        digests.append(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest())
    assert digests[0] == digests[1]


def test_a_loaded_volume_continues_like_the_saved_one(tmp_path: Path) -> None:
    config = TsdfConfig(semantic=True, record_free_space=True, max_range_m=12.0)
    poses = flight(4)
    saved = fly(TsdfVolume(config), poses[:3])
    saved.save(tmp_path / "volume.npz")
    loaded = TsdfVolume(config)
    loaded.load(tmp_path / "volume.npz")
    assert loaded.frames == 3
    for volume in (saved, loaded):
        fly(volume, poses[3:])
    assert same_mesh(saved.extract_mesh(), loaded.extract_mesh())
    assert saved.volume_observed_m3 == loaded.volume_observed_m3
    with np.load(tmp_path / "volume.npz") as arrays:
        assert arrays["tsdf"].shape == (len(arrays["blocks"]), 8, 8, 8)
        assert np.abs(arrays["tsdf"]).max() <= 1
        assert arrays["weight"].max() == 2


def test_a_file_without_classes_is_refused_by_a_volume_with_classes(tmp_path: Path) -> None:
    fly(TsdfVolume(), flight(1)).save(tmp_path / "volume.npz")
    with pytest.raises(InvalidInputError, match="class_id"):
        TsdfVolume(TsdfConfig(semantic=True)).load(tmp_path / "volume.npz")
