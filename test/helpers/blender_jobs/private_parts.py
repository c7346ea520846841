"""What tests have done in Blender's own process with private parts of Blender taken away."""

from __future__ import annotations

import logging
import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any, NamedTuple
from unittest import mock

import bpy
import numpy as np
from blender_jobs import errors
from numpy.typing import NDArray
from synthetic_worlds import LABELS, camera, rocky_world, settings

from oaisys_core.errors import CancelledError
from oaisys_core.geometry import pose_looking_at
from oaisys_core.private import (
    c_output,
    cycles_addon,
    cycles_log,
    cycles_session,
    embree,
    open_image_denoise,
)
from oaisys_core.render.blender import BlenderBackend, postprocessing
from oaisys_core.system import fallbacks
from oaisys_core.system.ending.interruption import interruptible
from oaisys_core.types import RGB, Progress

CACHED = (
    embree.blenders_embree,
    open_image_denoise.blenders_open_image_denoise,
    postprocessing.blenders_denoiser,
    cycles_session._cancel_function,
    cycles_log._channel,
    c_output._c_streams,
    fallbacks.report_fallback,
)
VIEW = camera(pose_looking_at((-6, -5, 3), (2, 1, 0)), modalities=(*LABELS, RGB))
WANTED = replace(settings(8), denoise=True)
CHANGED = replace(WANTED, samples=4, seed=3)
LONG = 100
"""Samples per pixel that take longer than it takes to end them."""


class Outcome(NamedTuple):
    """Images of two views with different settings, and what the log says."""

    images: list[dict[str, NDArray[Any]]]
    warnings: list[str]
    told: Any = None


def outcomes() -> dict[str, Outcome]:
    """Outcomes with all parts, and without each of them, by the part's module."""
    gone: dict[str, Any] = {"rtcGone": (None, []), "oidnGone": (None, [])}
    missing: dict[str, tuple[Any, ...]] = {
        "all": (),
        "embree": (mock.patch.dict(embree._SIGNATURES, gone),),
        "open_image_denoise": (mock.patch.dict(open_image_denoise._SIGNATURES, gone),),
        "cycles_addon": (mock.patch.object(cycles_addon, "UPDATE", "gone"),),
        "c_output": (mock.patch.object(c_output, "OUTPUT", "gone"),),
    }
    found = {}
    for name, patches in missing.items():
        with _without(*patches) as warnings:
            images = _images()
        found[name] = Outcome(images, warnings)
    with _without(mock.patch.object(cycles_session, "CANCEL_SYMBOL", b"gone")) as warnings:
        told = _cancelled()
        found["cycles_session"] = Outcome(_images(), warnings, told)
    of_log = [mock.patch.object(cycles_log, name, value) for name, value in LOGS.items()]
    with _without(*of_log) as warnings:
        errors_told = {"object": _error_of_object(), "ground": errors._black(RGB, True, 0.7)}
        found["cycles_log"] = Outcome(_images(), warnings, errors_told)
    return found


LOGS = {"LOG_SYMBOL": b"gone", "ERROR_STREAM": "gone"}


@contextmanager
def _without(*patches: Any) -> Iterator[list[str]]:
    """Take parts away during a block, and yield what is written to the log."""
    for function in CACHED:
        function.cache_clear()
    warnings: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: warnings.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger("oaisys_core")
    logger.addHandler(handler)
    try:
        with ExitStack() as stack, _printed_nowhere():
            for patch in patches:
                stack.enter_context(patch)
            yield warnings
    finally:
        logger.removeHandler(handler)
        for function in CACHED:
            function.cache_clear()


@contextmanager
def _printed_nowhere() -> Iterator[None]:
    """Write what Blender prints to a file that is removed."""
    kept = os.dup(1)
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 1)
        try:
            yield
        finally:
            os.dup2(kept, 1)
            os.close(kept)


def _images() -> list[dict[str, NDArray[Any]]]:
    backend = BlenderBackend()
    backend.build(rocky_world(), lambda _: None)
    views = [backend.render_all([VIEW], wanted, lambda _: None) for wanted in (WANTED, CHANGED)]
    backend.close()
    return [{frame.modality: np.array(frame.data) for frame in frames} for frames in views]


def _cancelled() -> bool:
    """Whether a render that is cancelled while Cycles samples ends as cancelled."""
    sampled: list[bool] = []

    def check() -> None:
        if sampled:
            raise CancelledError("enough")

    def listen(progress: Progress) -> None:
        if progress.stage == "color":
            sampled.append(True)

    backend = BlenderBackend()
    backend.build(rocky_world(), lambda _: None)
    with interruptible(check):
        try:
            backend.render_all([replace(VIEW, modalities=(RGB,))], settings(LONG), listen)
        except CancelledError:
            return True
    return False


def _error_of_object() -> str:
    """The error of a render of an object whose shader does not fit Cycles' stack."""
    backend = errors._backend()
    bpy.context.scene.cycles.shading_system = False
    thing = errors._with_huge_material()
    try:
        return errors._error(backend)
    finally:
        bpy.data.objects.remove(thing)
