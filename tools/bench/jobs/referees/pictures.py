"""Pictures of surveys, flights and a stereo rig; what COLMAP, Open3D and OpenCV make of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from oaisys_core.config.sections.drive import GRAVITY_M_S2, DroneConfig
from oaisys_core.geometry import nadir_spacing_m, pose_looking_at, pose_looking_down
from oaisys_core.simulation import Simulation
from oaisys_core.trajectory.drone import plan_flight
from oaisys_core.types import DEPTH, DISPARITY, RGB, Frame, ModuleMetadata, Pose, merge
from tools.bench.jobs.world import simulation_of, world_config
from tools.bench.referees.rgbd_odometry import rgbd_figures
from tools.bench.referees.stereo_matching import stereo_figures
from tools.bench.referees.structure_from_motion import survey_figures, write_survey
from tools.bench.settings import Say, Settings, camera

OVERLAP = 0.75
HEIGHT_M = 8.0
"""Of the camera over the mean ground."""
TILT_RAD = np.radians(25.0)
HEADINGS_RAD = np.radians((0.0, 90.0, 180.0, 270.0))
ASIDE_M = (-1.0, 1.0)
"""Where the two pictures of a heading are, across it."""
CASES = ("known", "unknown", "wrong")
RATE_HZ = 10.0
BASELINE_M, STEREO_HEIGHT_M = 0.25, 5.0
DOWN_45_XYZW = (0.0, 0.38268343, 0.0, 0.92387953)


def survey(
    settings: Settings,
    say: Say,
    quality: str,
    rows: int,
    columns: int,
    seed: int,
    wrong_focal: float,
    cases: Sequence[str] = CASES,
    world: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return COLMAP's figures of a survey by case: with K, without, and with a wrong one.

    Args:
        settings: Of the run.
        say: Called with the progress.
        quality: Preset of the pictures.
        rows, columns: Of the grid of pictures that look straight down.
        seed: Of the world.
        wrong_focal: The wrong focal length, as a share of the true one.
        cases: Which of `CASES`.
        world: Changes of the demo's world.
    """
    with _demo(settings, quality, seed, world) as simulation, TemporaryDirectory() as out:
        ground_m = _ground_m(simulation)
        spacing_m = nadir_spacing_m(HEIGHT_M, OVERLAP, simulation.info().sensors[0].intrinsics)
        down = _looking_down(rows, columns, spacing_m, ground_m)
        around = _looking_aside(ground_m)
        say(0.1, f"{quality}: {len(down) + len(around)} pictures")
        frames = {
            name: _frames(simulation, pose, [RGB])[0] for name, pose in {**down, **around}.items()
        }
        nadir, oblique = Path(out, "nadir"), Path(out, "oblique")
        write_survey(nadir, {name: frames[name] for name in down}, ground_m)
        write_survey(oblique, frames, ground_m)
        say(0.5, f"{quality}: COLMAP")
        given = {
            "known": (nadir, 1.0),
            "unknown": (oblique, None),
            "wrong": (oblique, wrong_focal),
        }
        return {
            case: asdict(survey_figures(given[case][0], given_focal=given[case][1]))
            for case in cases
        }


def flight(
    settings: Settings,
    say: Say,
    quality: str,
    pictures: int,
    seed: int,
    world: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return Open3D's figures of a drone's flight, at `RATE_HZ`; ``world`` changes the demo's."""
    sensors = {"cameras": [_camera(settings)]}
    with _demo(settings, quality, seed, world, sensors) as simulation:
        z_m = _ground_m(simulation) + 5.0
        way_m = np.array([(-8, -6, z_m), (0, -3, z_m + 1), (6, 4, z_m), (0, 9, z_m)], float)
        planned = plan_flight(DroneConfig(kind="drone"), way_m, GRAVITY_M_S2["earth"])
        # Without the start from rest, where pictures are all the same.
        times_s = planned.start_s + 2.0 + np.arange(pictures) / RATE_HZ
        colour, depth = [], []
        for i, time_s in enumerate(times_s.tolist()):
            say(0.1 + 0.8 * i / pictures, quality)
            by_modality = _frames(simulation, planned.pose(time_s), [RGB, DEPTH])
            colour.append(by_modality[0])
            depth.append(by_modality[1])
        return asdict(rgbd_figures(colour, depth))


def stereo(
    settings: Settings,
    say: Say,
    quality: str,
    seed: int,
    world: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return OpenCV's figures of a stereo rig over the ground; ``world`` changes the demo's."""
    rig = {"name": "stereo", "baseline_m": BASELINE_M, "modalities": [RGB, DISPARITY]}
    sensors = {"cameras": [], "stereo": [_camera(settings) | rig]}
    with _demo(settings, quality, seed, world, sensors) as simulation:
        say(0.2, quality)
        pose = Pose((0.0, 0.0, _ground_m(simulation) + STEREO_HEIGHT_M), (0.0, 0.0, 0.0, 1.0))
        sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))
        left, right = sorted({frame.sensor for frame in sample.frames})
        return asdict(
            stereo_figures(
                sample.frame(left, RGB).data,
                sample.frame(right, RGB).data,
                sample.frame(left, DISPARITY).data,
            )
        )


@contextmanager
def _demo(
    settings: Settings,
    quality: str,
    seed: int,
    changes: Mapping[str, Any] | None,
    sensors: Mapping[str, Any] | None = None,
) -> Iterator[Simulation]:
    """Yield a simulation with a batch of the demo's world, with changes on top."""
    render = {"quality": quality, "exposure_ev": 0.0}
    ours = {"seed": seed, "render": render, "sensors": sensors or {}}
    with simulation_of(world_config(settings, merge(changes or {}, ours))) as simulation:
        simulation.step_batch()
        yield simulation


def _camera(settings: Settings) -> dict[str, Any]:
    """Return a camera that looks 45 degrees down."""
    (plain,) = camera(settings.width_px, settings.height_px)["sensors"]["cameras"]
    return {**plain, "mount_quat_xyzw": DOWN_45_XYZW}


def _frames(simulation: Simulation, pose: Pose, modalities: Sequence[str]) -> list[Frame]:
    sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}), modalities=modalities)
    return [sample.frame(sample.frames[0].sensor, modality) for modality in modalities]


def _ground_m(simulation: Simulation) -> float:
    """Return the mean height of the ground about the middle of the stage."""
    at = [(x, y, 0.0) for x in np.linspace(-5, 5, 5) for y in np.linspace(-5, 5, 5)]
    return float(np.mean(simulation.query_height(at).ground_height_m))


def _looking_down(
    rows: int, columns: int, spacing_m: tuple[float, float], ground_m: float
) -> dict[str, Pose]:
    """Return the poses of a grid; the upper edge of the pictures is towards +x."""
    across_m, along_m = spacing_m
    return {
        f"down_{i}_{j}.png": pose_looking_down(
            (i - (rows - 1) / 2) * along_m, (j - (columns - 1) / 2) * across_m, ground_m + HEIGHT_M
        )
        for i in range(rows)
        for j in range(columns)
    }


def _looking_aside(ground_m: float) -> dict[str, Pose]:
    """Return two poses for each heading, all tilted towards the middle."""
    poses = {}
    for i, heading in enumerate(HEADINGS_RAD):
        for j, aside_m in enumerate(ASIDE_M):
            target = aside_m * np.array((-np.sin(heading), np.cos(heading)))
            back_m = HEIGHT_M * np.tan(TILT_RAD)
            eye = target - back_m * np.array((np.cos(heading), np.sin(heading)))
            poses[f"aside_{i}_{j}.png"] = pose_looking_at(
                (*eye, ground_m + HEIGHT_M), (*target, ground_m)
            )
    return poses
