"""One world's times at `draft`, and the likeness of its pictures to those of `standard`."""

from __future__ import annotations

import time
from typing import Any

from tools.bench.jobs.world import Observer, simulation_of, world_config
from tools.bench.references import Image, psnr_db, ssim
from tools.bench.settings import Say, Settings, camera
from tools.bench.worlds.demo_views import PosedView

QUALITIES = ("geometry", "draft")
JUDGE = "standard"
SMALL_PX = (320, 240)


def measure(
    settings: Settings, say: Say, world: str, views: list[dict[str, Any]], rounds: int
) -> dict[str, Any]:
    """Return seconds and processor seconds of samples with all images, and likenesses.

    ``alone_s`` are those of this thread, which works while no other one does: bands of images are
    left to a pool.

    The camera moves between samples, and the qualities alternate. The first sample of each is not
    counted, except as ``first_s`` of draft, which has what it makes at a world's first view.
    """
    posed = [PosedView.from_dict(view) for view in views]
    found: dict[str, Any] = {"views": [], "first_s": 0.0}
    for size in ((settings.width_px, settings.height_px), SMALL_PX):
        say(0.0 if found["first_s"] == 0.0 else 0.8, f"{size[0]}x{size[1]}")
        with simulation_of(world_config(settings, camera(*size), world)) as simulation:
            simulation.step_batch()
            observer = Observer(simulation)
            taken: dict[str, dict[str, list[float]]] = {}
            for quality in QUALITIES:
                first_s, _ = observer.view(posed[-1], {"quality": quality})
                taken[quality] = {"s": [], "cpu_s": [], "alone_s": []}
            if size != SMALL_PX:
                found["first_s"] = first_s
            for view in posed * rounds:
                for quality, times in taken.items():
                    cpu_s, alone_s = time.process_time(), time.thread_time()
                    seconds, _ = observer.view(view, {"quality": quality})
                    times["s"].append(seconds)
                    times["cpu_s"].append(time.process_time() - cpu_s)
                    times["alone_s"].append(time.thread_time() - alone_s)
            if size == SMALL_PX:
                found["small_s"] = taken["draft"]["s"]
                continue
            found |= taken
            found["views"] = [_likeness(observer, view) for view in posed]
    return found


def _likeness(observer: Observer, view: PosedView) -> dict[str, float]:
    draft, judge = (_picture(observer, view, quality) for quality in ("draft", JUDGE))
    return {
        "psnr_db": psnr_db(draft, judge),
        "ssim": ssim(draft, judge),
        "brightness": float(draft.mean() / max(judge.mean(), 1.0)),
    }


def _picture(observer: Observer, view: PosedView, quality: str) -> Image:
    _, sample = observer.view(view, {"quality": quality}, ["rgb"])
    return sample.frames[0].data
