"""Digests of pictures of the same request."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import cv2
from numpy.typing import NDArray

from oaisys_core.types import RGB
from tools.bench.jobs.world import Observer, simulation_of, world_config
from tools.bench.settings import Say, Settings
from tools.bench.worlds.demo_views import VIEWS

QUALITIES = ("preview", "standard")


def pictures(settings: Settings, say: Say) -> dict[str, list[str]]:
    """Return the digests of RGB of one view by quality, first and after another view.

    Each picture is written to a file named by its digest, so that different ones can be compared.
    """
    found: dict[str, list[str]] = {quality: [] for quality in QUALITIES}
    with simulation_of(world_config(settings)) as simulation:
        say(0.0, "batch")
        simulation.step_batch(seed=11)
        observer = Observer(simulation)
        view, other = (each.pose(observer.heights_m, 0.0) for each in VIEWS[:2])
        for quality, digests in found.items():
            for pose in (view, other, view):
                _, sample = observer.sample(pose, {"quality": quality})
                if pose is view:
                    image = next(frame.data for frame in sample.frames if frame.modality == RGB)
                    digests.append(_write(settings.out / "pictures", quality, image))
    return found


def _write(folder: Path, name: str, image: NDArray[Any]) -> str:
    digest = hashlib.sha256(image.tobytes()).hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(folder / f"{name}_{digest}.png"), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    return digest
