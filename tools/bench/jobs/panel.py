"""One world of the panel: its random views, and times and quality of its samples.

With another checkout's packages on the path, `measure` times that checkout. It therefore uses only
configuration, simulation and types of `oaisys_core`, which earlier commits have, too.
"""

from __future__ import annotations

import time
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import oaisys_core
from oaisys_core.config import config_sha256
from oaisys_core.simulation import Simulation
from oaisys_core.types import DEPTH, RGB, Frame, Pose, Sample
from tools.bench.calibration import SpeedCalibration, calibrate
from tools.bench.jobs.quality import REFERENCE_SAMPLES as SIX_VIEWS_SAMPLES
from tools.bench.jobs.quality import reference_image
from tools.bench.jobs.world import Observer, simulation_of, world_config
from tools.bench.references import Image, ReferenceImage, psnr_db, sha256, ssim, top_octave_share
from tools.bench.settings import Say, Settings, camera
from tools.bench.worlds.demo_views import VIEWS, PosedView, by_light
from tools.bench.worlds.panel import SIX_VIEWS
from tools.bench.worlds.random_views import StageSurface, random_views

QUALITIES = ("geometry", "preview", "standard")
COLORED = QUALITIES[1:]
FIRST_QUALITY = "standard"
REFERENCE_SAMPLES, QUICK_REFERENCE_SAMPLES = 256, 64
SMALL_PX = (80, 60)
"""Size of the depth images by which a random view is judged."""


def draw_views(settings: Settings, say: Say, world: str, count: int) -> list[dict[str, Any]]:
    """Return the views of a world as data of `PosedView`, found without Blender.

    A world's views depend on its name and the run's seed, not on the other worlds.
    """
    say(0.0, "views")
    small = camera(*SMALL_PX)
    config = world_config(settings, {"backend": "analytic", **small}, world)
    with simulation_of(config) as simulation:
        simulation.step_batch()
        observer = Observer(simulation)
        if world == SIX_VIEWS:
            return [view.with_pose(observer.heights_m).to_dict() for view in VIEWS]
        extent_m = simulation.info().stage_extent_m
        assert extent_m is not None

        def depth(pose: Pose) -> Frame:
            return observer.view(PosedView("", pose), {}, [DEPTH])[1].frames[0]

        rng = np.random.default_rng([settings.views_seed, zlib.crc32(world.encode())])
        poses = random_views(count, StageSurface(extent_m, observer.heights_m, depth), rng)
    render = {"exposure_ev": config.render.exposure_ev}
    views = [PosedView(f"{world}_{i}", pose, {}, render) for i, pose in enumerate(poses)]
    return [view.to_dict() for view in views]


def measure(
    settings: Settings,
    say: Say,
    world: str,
    views: list[dict[str, Any]],
    rounds: int,
    *,
    with_references: bool,
    checkout: str = "",
) -> dict[str, Any]:
    """Return times of a world's batch and samples, and the quality of its pictures.

    Calibrations alternate with the samples. Each round visits all views of the same light, so that
    the camera moves between samples.

    Args:
        settings: Of the run.
        say: Called with the progress.
        world: Name of the world.
        views: Data of `PosedView`.
        rounds: Timed samples of each view and quality.
        with_references: Whether pictures are compared with converged ones.
        checkout: Root of the checkout that must be the one measured; empty: any.

    Returns:
        ``batch`` and ``first_sample`` with ``s`` and ``ratio``; ``device``; ``geometry_sha256`` of
        each view; by quality ``s``, ``ratio`` and ``views``, which have ``picture`` (a file),
        ``psnr_db``, ``ssim``, ``top_octave``, ``reference_s`` and ``is_reused``.
    """
    _check_checkout(checkout)
    config = world_config(settings, world=world)
    posed = [PosedView.from_dict(view) for view in views]
    with (
        SpeedCalibration(settings.out / "logs" / "calibration.log") as calibration,
        simulation_of(config) as simulation,
    ):
        say(0.0, "batch")
        found = _begin(simulation, posed[0], calibration)
        observer = Observer(simulation)
        samples: dict[str, list[Sample]] = {}
        for index, quality in enumerate(QUALITIES):
            say(0.1 + 0.2 * index, quality)
            found[quality], samples[quality] = _time(observer, posed, quality, rounds, calibration)
        found["device"] = simulation.info().device
        found["geometry_sha256"] = [_geometry_sha256(s) for s in samples[QUALITIES[0]]]
        facts = {"config": config_sha256(config), "blender": simulation.info().backend_version}
        references: list[ReferenceImage | None] = [None] * len(posed)
        if with_references:
            many = SIX_VIEWS_SAMPLES if world == SIX_VIEWS else REFERENCE_SAMPLES
            many = QUICK_REFERENCE_SAMPLES if settings.quick else many
            for index, view in enumerate(posed):
                say(0.7 + 0.3 * index / len(posed), f"{view.name}: {many} samples")
                references[index] = reference_image(observer, view, settings, facts, many)
    folder = settings.out / "panel" / ("other" if checkout else "")
    for quality in COLORED:
        found[quality]["views"] = [
            _judge(_color(sample), reference, folder / f"{view.name}_{quality}.png")
            for view, sample, reference in zip(posed, samples[quality], references, strict=True)
        ]
    return found


def _check_checkout(checkout: str) -> None:
    """Refuse to measure another checkout's code than the named one's."""
    used = Path(oaisys_core.__file__).resolve()
    if checkout and not used.is_relative_to(Path(checkout).resolve()):
        raise ValueError(f"received oaisys_core from {used}, expected it below {checkout}")


def _begin(
    simulation: Simulation, view: PosedView, calibration: SpeedCalibration
) -> dict[str, Any]:
    """Return the times of the process's first batch and of its first sample."""
    calibration_s = [calibration.seconds()]
    started_s = time.perf_counter()
    simulation.step_batch()
    seconds = [time.perf_counter() - started_s]
    calibration_s.append(calibration.seconds())
    seconds.append(Observer(simulation).view(view, _render(FIRST_QUALITY))[0])
    calibration_s.append(calibration.seconds())
    ratios = calibrate(seconds, calibration_s)
    return {
        name: {"s": [value], "ratio": [ratio]}
        for name, value, ratio in zip(("batch", "first_sample"), seconds, ratios, strict=True)
    }


def _time(
    observer: Observer,
    views: list[PosedView],
    quality: str,
    rounds: int,
    calibration: SpeedCalibration,
) -> tuple[dict[str, Any], list[Sample]]:
    """Return the times of samples at one quality, and the last sample of each view."""
    found: dict[str, list[float]] = {"s": [], "ratio": [], "calibration_s": []}
    samples: dict[str, Sample] = {}
    for group in by_light(views):
        # It changes the settings and the light, and is not counted.
        observer.view(group[-1], _render(quality))
        seconds, calibration_s = [], []
        for view in group * rounds:
            calibration_s.append(calibration.seconds())
            took_s, samples[view.name] = observer.view(view, _render(quality))
            seconds.append(took_s)
        calibration_s.append(calibration.seconds())
        found["s"] += seconds
        found["ratio"] += calibrate(seconds, calibration_s)
        found["calibration_s"] += calibration_s
    return found, [samples[view.name] for view in views]


def _render(quality: str) -> dict[str, Any]:
    """Return the metadata of a quality; they undo those of references."""
    return {"quality": quality, "samples": None, "denoise": True}


def _geometry_sha256(sample: Sample) -> str:
    """Return a hash of all images but colour."""
    return " ".join(sha256(frame.data) for frame in sample.frames if frame.modality != RGB)


def _color(sample: Sample) -> Image:
    return next(frame.data for frame in sample.frames if frame.modality == RGB)


def _judge(picture: Image, reference: ReferenceImage | None, file: Path) -> dict[str, Any]:
    """Write a picture, and return its file and its likeness to the reference."""
    file.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(file), picture[..., ::-1]):
        raise OSError(f"cannot write {file}")
    found: dict[str, Any] = {"picture": str(file)}
    if reference is not None:
        found |= {
            "psnr_db": psnr_db(picture, reference.image),
            "ssim": ssim(picture, reference.image),
            "top_octave": top_octave_share(picture, reference.image),
            "reference_s": reference.seconds,
            "is_reused": reference.is_reused,
        }
    return found
