"""Keeps recently rendered views, so that the same view is not rendered again."""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from oaisys_core.backend.base import RenderSettings
from oaisys_core.fingerprint import Digest, Fingerprints
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.types import ALBEDO, FLOW, RGB, Frame, Provenance
from oaisys_core.world.provenance import depends_on_past

_LOG = logging.getLogger(__name__)


class RenderedView(NamedTuple):
    """All frames of a view, and the samples per pixel of colour (0: none)."""

    frames: tuple[Frame, ...]
    render_samples: int

    @property
    def size_bytes(self) -> int:
        """Of all images."""
        return sum(frame.data.nbytes for frame in self.frames)


class PoseCache:
    """Keeps views within a bound of memory and drops the least recently used first.

    A view's key is a digest of all that its frames depend on: seeds, configuration, backend,
    device, the world's content, each camera with its pose, and the render settings. Frames that
    depend on more than that have no key: optical flow (on the sample before), colour with sensor
    noise (on the sample's number) and colour within a time budget (on the machine's speed).
    """

    def __init__(self, max_bytes: int) -> None:
        """Keep at most ``max_bytes`` of images; 0: none, which costs no time either."""
        self._max_bytes = max_bytes
        self._views: OrderedDict[Digest, RenderedView] = OrderedDict()
        self._fingerprints = Fingerprints()
        self._size = 0

    @property
    def size_bytes(self) -> int:
        """Of all images that are kept."""
        return self._size

    def key(
        self,
        provenance: Provenance,
        scene: Scene,
        cameras: Sequence[PlacedCamera],
        settings: RenderSettings,
    ) -> Digest | None:
        """Return what tells this view from all others; None if it must be rendered."""
        if not self._max_bytes or not cameras or not _is_repeatable(cameras, settings):
            return None
        world = (scene.ground, scene.material, scene.prototypes, scene.placements)
        seen = [_without_past(camera) for camera in cameras]
        how = replace(settings, noise_seed=0)
        try:
            return self._fingerprints.of(
                (_without_history(provenance), world, scene.primitives, scene.sky, seen, how)
            )
        except TypeError as error:  # a module of another package drew something of its own
            _LOG.debug("not kept: %s", error)
            return None

    def forget_world(self) -> None:
        """Let go of the world of the last key; views of it are kept."""
        self._fingerprints.forget()

    def get(self, key: Digest | None) -> RenderedView | None:
        """Return a view, or None; nobody can change its images."""
        if key is None or key not in self._views:
            return None
        self._views.move_to_end(key)
        return self._views[key]

    def add(self, key: Digest | None, view: RenderedView) -> None:
        """Keep a view, unless it has no key or is too large; images that may change are copied."""
        if key is None or view.size_bytes > self._max_bytes:
            return
        if key in self._views:
            self._size -= self._views.pop(key).size_bytes
        while self._size + view.size_bytes > self._max_bytes:
            _, oldest = self._views.popitem(last=False)
            self._size -= oldest.size_bytes
        frames = tuple(replace(f, data=_constant(f.data)) for f in view.frames)
        self._views[key] = view._replace(frames=frames)
        self._size += view.size_bytes


def _without_history(provenance: Provenance) -> Provenance:
    """Return it without how the world came about, whose content is in the key."""
    return replace(provenance, stage_seed=0, asset_seed=0, metadata_json="", previous_poses_json="")


def _is_repeatable(cameras: Sequence[PlacedCamera], settings: RenderSettings) -> bool:
    modalities = {modality for camera in cameras for modality in camera.modalities}
    if FLOW in modalities:
        return False
    noisy = RGB in modalities and settings.effects.noise is not None
    hurried = settings.time_budget_s is not None and not modalities.isdisjoint({RGB, ALBEDO})
    return not noisy and not hurried


def _without_past(camera: PlacedCamera) -> PlacedCamera:
    """Return the camera without the pose before, where nothing that is rendered depends on it."""
    if depends_on_past(camera):
        return camera
    return replace(camera, T_map_previous=None)


def _constant(data: Any) -> Any:
    """Return an image that nobody can change: a copy, unless it is one already."""
    array = data
    while isinstance(array, np.ndarray) and not array.flags.writeable:
        array = array.base
    if not isinstance(array, np.ndarray):
        return data
    copied = np.array(data)
    copied.flags.writeable = False
    return copied
