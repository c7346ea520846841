"""Time and quality of colour, by preset and view."""

from __future__ import annotations

from typing import Any

from oaisys_core.config import config_sha256
from oaisys_core.types import RGB
from tools.bench.jobs.world import Observer, simulation_of, world_config
from tools.bench.references import (
    KEY_SAMPLES,
    Image,
    ReferenceImage,
    ReferenceImages,
    psnr_db,
    sha256,
    ssim,
    top_octave_share,
)
from tools.bench.settings import Say, Settings
from tools.bench.worlds.demo_views import VIEWS, BenchView, PosedView

REFERENCE_SAMPLES, QUICK_REFERENCE_SAMPLES = 512, 64
CAMERA_STEP_M = 0.15
"""Motion of the camera between two samples."""
RUNS_OF_FINAL = 1


def presets(settings: Settings, say: Say) -> list[dict[str, Any]]:
    """Return, for each view, the time of its reference, and times and quality of each preset."""
    views = VIEWS
    names = ["geometry", "preview", "standard", "high", *(["final"] * settings.with_final)]
    samples = QUICK_REFERENCE_SAMPLES if settings.quick else REFERENCE_SAMPLES
    rows = []
    config = world_config(settings)
    with simulation_of(config) as simulation:
        simulation.step_batch()
        observer = Observer(simulation)
        version = simulation.info().backend_version
        for index, view in enumerate(views):
            share = index / len(views)
            say(share, f"{view.name}: reference")
            facts = {"config": config_sha256(config), "blender": version}
            posed = view.with_pose(observer.heights_m)
            reference = reference_image(observer, posed, settings, facts, samples)
            by_preset = {}
            for each, name in enumerate(names):
                say(share + (0.5 + 0.5 * each / len(names)) / len(views), f"{view.name}: {name}")
                by_preset[name] = _preset(observer, view, name, reference.image, settings)
            rows.append(
                {
                    "view": view.name,
                    "reference_s": reference.seconds,
                    "is_reused": reference.is_reused,
                    "presets": by_preset,
                }
            )
    return rows


def reference_image(
    observer: Observer, view: PosedView, settings: Settings, facts: dict[str, str], samples: int
) -> ReferenceImage:
    """Return the converged image of a view, from an earlier run if nothing has changed since.

    The image at few samples per pixel is part of the key, because any change of materials, shaders,
    light or colour management changes it.

    Args:
        observer: Of the simulation.
        view: Which is rendered.
        settings: Of the run.
        facts: What the image depends on besides view, size and samples.
        samples: Samples per pixel.
    """

    def render(count: int) -> tuple[float, Image]:
        quality = {"quality": "final", "samples": count, "denoise": False}
        seconds, sample = observer.view(view, quality, [RGB])
        return seconds, sample.frames[0].data

    _, noisy = render(KEY_SAMPLES)
    key = {
        **facts,
        "pose": [*view.pose.position_m, *view.pose.quat_xyzw],
        "environment": dict(view.environment),
        "render": dict(view.render),
        "size": [settings.width_px, settings.height_px],
        "samples": samples,
        "few_samples": sha256(noisy),
    }
    folder = settings.out / "references"
    return ReferenceImages(folder).get(view.name, key, lambda: render(samples))


def _preset(
    observer: Observer, view: BenchView, name: str, reference: Image, settings: Settings
) -> dict[str, Any]:
    """Return the seconds of samples around a view, and the quality of the view itself.

    The first sample, which changes settings and light, is not counted.
    """
    runs = RUNS_OF_FINAL if name == "final" else settings.runs
    # Settings persist in a simulation, so each view sets all of them.
    render = {"quality": name, "samples": None, "denoise": True, "exposure_ev": 0.0, **view.render}
    seconds = []
    for index in range(runs + 1):
        pose = view.pose(observer.heights_m, offset_m=CAMERA_STEP_M * (runs - index))
        took_s, sample = observer.sample(pose, render, view.environment)
        seconds.append(took_s)
    result: dict[str, Any] = {"seconds": seconds[1:]}
    colors = [frame.data for frame in sample.frames if frame.modality == RGB]
    if colors:
        result |= {
            "psnr_db": psnr_db(colors[0], reference),
            "ssim": ssim(colors[0], reference),
            "top_octave": top_octave_share(colors[0], reference),
        }
    return result
