"""Makes the stages beside this file: `python make_stages.py [FOLDER]`."""

# ruff: noqa: INP001 - a script, not a package

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import trimesh

from oaisys_core.procedural.terrain.presets import make_ground
from oaisys_core.world.stage_store import StageRecord, content_hash, save_stage

DEM_PX = 97
DEM_STEP_M = 0.001
"""Metres per count of the image."""


def write_dem(path: Path) -> None:
    """Write a valley of 96 m as a 16-bit image, in millimetres."""
    rng = np.random.default_rng(4)
    ground = make_ground("mountain_2", 96.0, DEM_PX, rng, roughness=0.3, relief_m=16.0)
    counts = (ground.elevation_m - ground.elevation_m.min()) / DEM_STEP_M
    cv2.imwrite(str(path), np.rint(counts)[::-1].astype(np.uint16))


def write_mesh(path: Path) -> None:
    """Write an old crater, 60 m wide, as rings that are closer where it is steep."""
    radius_m = np.concatenate((np.linspace(2, 14, 8), np.linspace(15, 30, 8)))
    angle = np.linspace(0, 2 * np.pi, 28, endpoint=False)
    r, a = np.meshgrid(radius_m, angle, indexing="ij")
    r = r * (1 + 0.05 * np.sin(3 * a) + 0.03 * np.sin(7 * a + 1))
    bowl = np.where(r < 15, 4.0 * (r / 15) ** 2 - 3.0, np.exp(-(r - 15) / 6))
    z = bowl + 0.12 * np.sin(5 * a + r) * np.minimum(r / 8, 1)
    ring = np.stack((r * np.cos(a), r * np.sin(a), z), axis=-1).reshape(-1, 3)
    vertices = np.vstack(((0.0, 0.0, -3.0), ring))
    count = len(angle)
    index = 1 + np.arange(len(ring)).reshape(len(radius_m), count)
    after = np.roll(index, -1, axis=1)
    cap = np.stack((np.zeros(count, int), index[0], after[0]), axis=-1)
    inner, outer = index[:-1], index[1:]
    sides = np.concatenate(
        (
            np.stack((inner, outer, after[1:]), axis=-1).reshape(-1, 3),
            np.stack((inner, after[1:], after[:-1]), axis=-1).reshape(-1, 3),
        )
    )
    mesh = trimesh.Trimesh(vertices, np.concatenate((cap, sides)), process=False)
    mesh.export(path, encoding="binary", vertex_normal=False)


def write_stage(path: Path) -> None:
    """Write a hill as ``stage.save_as`` keeps it."""
    ground = make_ground("mountain_1", 48.0, 65, np.random.default_rng(6), roughness=0.5)
    record = StageRecord(
        stage_hash=content_hash(ground),
        ground=ground,
        stage_seed=6,
        asset_seed=6,
        assets_sha256="",
    )
    save_stage(path, record)


def main(folder: Path) -> None:
    """Write everything."""
    write_stage(folder / "stage_hill.npz")
    write_dem(folder / "valley.png")
    write_mesh(folder / "old_crater.ply")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    usual = Path(__file__).parent
    parser.add_argument("folder", nargs="?", type=Path, default=usual, help="where to write")
    main(parser.parse_args().folder)
