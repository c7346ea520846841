"""What tests of devices have done in Blender's own process, see `blender_process.in_blender`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from synthetic_worlds import camera, rocky_world, settings

from oaisys_core.geometry import pose_looking_at
from oaisys_core.render.blender import BlenderBackend
from oaisys_core.types import RGB, PinholeIntrinsics

SAMPLES, DENOISED_SAMPLES = 64, 4
WIDE = PinholeIntrinsics(96, 72, 81.0, 81.0, 47.5, 35.5)


def pictures() -> dict[str, Any]:
    """One view on the CPU, with another seed and brighter; and on the GPU, if there is one."""
    view = camera(pose_looking_at((-6, -5, 3), (2, 1, 0)), WIDE, (RGB,))
    backend = BlenderBackend()
    backend.build(rocky_world(), lambda _: None)

    def picture(**changes: Any) -> Any:
        return backend.render_all([view], replace(settings(SAMPLES), **changes))[0].data

    few = {"samples": DENOISED_SAMPLES, "denoise": True}
    found: dict[str, Any] = {
        "cpu": picture(device="cpu"),
        "another seed": picture(device="cpu", seed=1),
        "brighter": picture(device="cpu", exposure_ev=0.1),
        "auto": picture(device="auto"),
    }
    found["device"] = backend.device
    if backend.device != "cpu":
        found["auto denoised"] = picture(device="auto", **few)
        found["cpu denoised"] = picture(device="cpu", **few)
        found["converged"] = picture(device="cpu", samples=8 * SAMPLES, seed=2)
    return found
