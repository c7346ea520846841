"""Choice of the device that Cycles renders on."""

from __future__ import annotations

import logging
from typing import Any

import bpy

from oaisys_core.sensing.render_settings import Device

_LOG = logging.getLogger(__name__)

GPU_KINDS: tuple[Device, ...] = ("optix", "cuda", "hip", "oneapi", "metal")
"""GPU interfaces, in the order in which ``auto`` prefers them."""


def use_device(wanted: Device) -> Device:
    """Have Cycles render and denoise on a kind of device, and return the kind in use.

    ``auto`` takes a GPU if there is one. A kind that is not available is replaced by the CPU, with
    a warning.
    """
    kind = _available(wanted)
    cycles: Any = bpy.context.scene.cycles
    is_gpu = kind != "cpu"
    cycles.device = "GPU" if is_gpu else "CPU"
    cycles.denoising_use_gpu = is_gpu
    if is_gpu:
        _choose_gpus(kind)
    _LOG.info("colour is rendered on %s (render.device: %s)", _device_name(kind), wanted)
    return kind


def _available(wanted: Device) -> Device:
    if wanted == "cpu":
        return "cpu"
    if wanted == "auto":
        return next((kind for kind in GPU_KINDS if _gpus(kind)), "cpu")
    if _gpus(wanted):
        return wanted
    found = [kind for kind in GPU_KINDS if _gpus(kind)]
    _LOG.warning(
        "render.device: Cycles finds no device of kind %s, only %s: colour is rendered on the CPU",
        wanted,
        ", ".join([*found, "cpu"]),
    )
    return "cpu"


def _gpus(kind: Device) -> list[str]:
    """Return the names of the GPUs of a kind."""
    return [device.name for device in _devices(kind) if device.type == kind.upper()]


def _devices(kind: Device) -> list[Any]:
    """Return the devices that Blender's preferences offer with a kind; CPUs are among them."""
    return list(_preferences().get_devices_for_type(kind.upper()))


def _preferences() -> Any:
    return bpy.context.preferences.addons["cycles"].preferences


def _choose_gpus(kind: Device) -> None:
    """Use all GPUs of a kind and no CPU, which casts the rays of depth and labels meanwhile."""
    _preferences().compute_device_type = kind.upper()
    for device in _devices(kind):
        device.use = device.type == kind.upper()


def _device_name(kind: Device) -> str:
    names = _gpus(kind)
    return f"{kind} ({', '.join(names)})" if names else kind


def gpu_names() -> dict[str, list[str]]:
    """Return the names of the GPUs that Cycles can use, by kind; kinds without one are left out."""
    found = {kind: _gpus(kind) for kind in GPU_KINDS}
    return {kind: names for kind, names in found.items() if names}
