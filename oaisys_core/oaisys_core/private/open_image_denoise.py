"""The C interface of the Open Image Denoise library that comes with Blender.

Private part: ``libOpenImageDenoise.so.2`` as Blender has loaded it, called by ctypes.
Tried with: Open Image Denoise 2.3.3 of bpy 4.5.15, 2.5.0 of bpy 5.2.3.
Public way without it: Cycles denoises (``scene.cycles.use_denoising``).
Lost without it: light cannot be denoised apart from textures, which costs 0.2 dB in the median and
    up to 1 dB; and time budgets are missed, because Cycles denoises as part of its last sample.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterable, Mapping
from ctypes import (
    CDLL,
    CFUNCTYPE,
    POINTER,
    byref,
    c_bool,
    c_char_p,
    c_double,
    c_int,
    c_size_t,
    c_void_p,
)
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import RenderError
from oaisys_core.system.ending.interruption import make_wanted_check, stop_if_unwanted
from oaisys_core.system.fallbacks import report_fallback

Image = NDArray[np.float32]

LIBRARY = "libOpenImageDenoise.so.2"
"""Blender has loaded it already, so the dynamic linker finds it without a path."""

CPU_DEVICE, FLOAT3 = 1, 3
QUALITY_FAST, QUALITY_BALANCED = 4, 5
"""Values of ``OIDNDeviceType``, ``OIDNFormat`` and ``OIDNQuality``."""

OUTPUT = b"output"
"""Name of a filter's result."""

MAX_KEPT_PIXELS = 1920 * 1080
"""Filters of larger images are not kept for the next one, because of their memory."""

_ProgressMonitor = CFUNCTYPE(c_bool, c_void_p, c_double)
"""Type of ``OIDNProgressMonitorFunction``: returns whether to go on."""

_SIGNATURES: dict[str, tuple[Any, list[Any]]] = {
    "oidnNewDevice": (c_void_p, [c_int]),
    "oidnSetDeviceBool": (None, [c_void_p, c_char_p, c_bool]),
    "oidnCommitDevice": (None, [c_void_p]),
    "oidnGetDeviceError": (c_int, [c_void_p, POINTER(c_char_p)]),
    "oidnNewFilter": (c_void_p, [c_void_p, c_char_p]),
    "oidnSetSharedFilterImage": (
        None,
        [c_void_p, c_char_p, c_void_p, c_int, *[c_size_t] * 5],
    ),
    "oidnSetFilterBool": (None, [c_void_p, c_char_p, c_bool]),
    "oidnSetFilterInt": (None, [c_void_p, c_char_p, c_int]),
    "oidnSetFilterProgressMonitorFunction": (None, [c_void_p, _ProgressMonitor, c_void_p]),
    "oidnCommitFilter": (None, [c_void_p]),
    "oidnExecuteFilter": (None, [c_void_p]),
    "oidnReleaseFilter": (None, [c_void_p]),
}


class OpenImageDenoise:
    """Filters images on the CPU, and keeps the filters for images of the same size."""

    def __init__(self, library: CDLL) -> None:
        self._library = library
        for name, (result, arguments) in _SIGNATURES.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
        self._device = library.oidnNewDevice(CPU_DEVICE)
        # Else it would bind this process's threads to cores, including those of Cycles.
        library.oidnSetDeviceBool(self._device, b"setAffinity", False)
        library.oidnCommitDevice(self._device)
        self._check()
        self._size = (0, 0)
        self._filters: dict[tuple[Any, ...], _Filter] = {}

    def filter(self, images: Mapping[bytes, Image], quality: int, **flags: bool) -> Image:
        """Return an (H, W, 3) image that is denoised.

        Args:
            images: (H, W, 3 or more) by the library's names; the first one is denoised.
            quality: A value of ``OIDNQuality``.
            flags: The filter's parameters that are true or false.

        Raises:
            OaisysError: The image is no longer wanted.
            RenderError: The library failed.
        """
        height, width, _ = next(iter(images.values())).shape
        size = height, width
        if size != self._size:
            self._filters, self._size = {}, size
        wanted = (tuple(images), quality, *flags.items())
        made = self._filters.get(wanted)
        if made is None:
            made = _Filter(self._library, self._device, (*images, OUTPUT), size, quality, flags)
            self._check()
            if height * width <= MAX_KEPT_PIXELS:
                self._filters[wanted] = made
        result = made.run(images)
        self._check()
        return result

    def _check(self) -> None:
        message = c_char_p()
        has_failed = self._library.oidnGetDeviceError(self._device, byref(message))
        stop_if_unwanted()  # The library reports that as a failure, too.
        if has_failed:
            text = (message.value or b"no reason given").decode(errors="replace")
            raise RenderError(f"Open Image Denoise failed: {text}")


class _Filter:
    """One of the library's filters with its image buffers.

    Its working memory is kept between images, because the system would clear it anew for each.
    """

    def __init__(
        self,
        library: CDLL,
        device: Any,
        names: Iterable[bytes],
        size: tuple[int, int],
        quality: int,
        flags: Mapping[str, bool],
    ) -> None:
        """Set up a filter of (H, W) images; the last name is its result."""
        self._library = library
        self._handle = handle = library.oidnNewFilter(device, b"RT")
        weakref.finalize(self, library.oidnReleaseFilter, handle).atexit = False
        height, width = size
        self._images = {name: np.empty((height, width, 3), np.float32) for name in names}
        for name, image in self._images.items():
            library.oidnSetSharedFilterImage(
                handle, name, image.ctypes.data, FLOAT3, width, height, 0, 0, 0
            )
        for flag, value in flags.items():
            library.oidnSetFilterBool(handle, flag.encode(), value)
        library.oidnSetFilterInt(handle, b"quality", quality)
        library.oidnCommitFilter(handle)

    def run(self, images: Mapping[bytes, Image]) -> Image:
        """Return the (H, W, 3) result of images with at least three channels.

        It is incomplete where it is no longer wanted.
        """
        for name, image in images.items():
            self._images[name][...] = image[..., :3]
        is_wanted = make_wanted_check()
        monitor = _ProgressMonitor(lambda _pointer, _share: is_wanted())
        self._library.oidnSetFilterProgressMonitorFunction(self._handle, monitor, None)
        self._library.oidnExecuteFilter(self._handle)
        return self._images[OUTPUT].copy()


@cache
def blenders_open_image_denoise() -> OpenImageDenoise | None:
    """Return the library as Blender has loaded it; None if it is another version."""
    try:
        return OpenImageDenoise(CDLL(LIBRARY))
    except (OSError, AttributeError, RenderError) as error:
        instead = "Cycles denoises, which keeps less detail and holds no time budgets"
        report_fallback("Blender's Open Image Denoise", str(error), instead)
        return None
