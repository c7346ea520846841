"""Keeps recently rendered views, by a digest of all that they depend on."""

from __future__ import annotations

import dataclasses
import hashlib
import logging
import struct
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import DIGITAL, FLOW, RENDERED, RGB, Frame, Provenance

_LOG = logging.getLogger(__name__)

Digest = bytes


class RenderedView(NamedTuple):
    """All frames of a view, and the samples per pixel (0: none) and exposures of its colour."""

    frames: tuple[Frame, ...]
    render_samples: int
    exposures_json: str = ""

    @property
    def size_bytes(self) -> int:
        """Size of all images."""
        return sum(frame.data.nbytes for frame in self.frames)


class ViewCache:
    """Keeps views within a bound of memory and drops the least recently used first.

    A view's key is a digest of all that its frames depend on: seeds, configuration, backend,
    device, the world's content, each camera with its pose, and the render settings. Frames that
    depend on more than that have no key: optical flow (on the sample before), colour with sensor
    noise and digital numbers (on the sample's number) and colour within a time budget (on the
    machine's speed).
    """

    def __init__(self, max_bytes: int) -> None:
        """Keep at most ``max_bytes`` of images; with 0, no digests are computed either."""
        self._max_bytes = max_bytes
        self._views: OrderedDict[Digest, RenderedView] = OrderedDict()
        self._fingerprints = Fingerprints()
        self._size = 0
        self._told = False

    @property
    def size_bytes(self) -> int:
        """Size of all images that are kept."""
        return self._size

    def key(
        self,
        provenance: Provenance,
        scene: Scene,
        cameras: Sequence[PlacedCamera],
        settings: RenderSettings,
    ) -> Digest | None:
        """Return the key of a view; None if it must be rendered."""
        if not self._max_bytes or not cameras or not _is_repeatable(cameras, settings):
            return None
        world = (scene.ground, scene.material, scene.prototypes, scene.placements)
        light = (scene.sky, scene.lamps)
        seen = [_without_past(camera) for camera in cameras]
        how = replace(settings, noise_seed=0)
        try:
            return self._fingerprints.of(
                (_without_history(provenance), world, scene.primitives, light, seen, how)
            )
        except TypeError as error:  # a module of another package drew data of another type
            if not self._told:
                _LOG.warning("equal views of this world are rendered again each time: %s", error)
            self._told = True
            return None

    def forget_world(self) -> None:
        """Forget the digests of the last world; its views are kept."""
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
    """Return the provenance without the history of the world, whose content is in the key."""
    return replace(
        provenance,
        stage_seed=0,
        asset_seed=0,
        metadata_json="",
        previous_poses_json="",
        motion_json="",
    )


def _is_repeatable(cameras: Sequence[PlacedCamera], settings: RenderSettings) -> bool:
    modalities = {modality for camera in cameras for modality in camera.modalities}
    if FLOW in modalities:
        return False
    noisy = RGB in modalities and settings.effects.noise is not None
    noisy |= not modalities.isdisjoint(DIGITAL)
    hurried = settings.time_budget_s is not None and not modalities.isdisjoint(RENDERED)
    return not noisy and not hurried


def _without_past(camera: PlacedCamera) -> PlacedCamera:
    """Return the camera without its previous pose and motion, unless its images depend on them."""
    if camera.depends_on_past:
        return camera
    return replace(camera, T_map_previous=None, pose_at=None)


def _constant(data: Any) -> Any:
    """Return a read-only image: a copy, unless no reference to its memory is writeable."""
    array = data
    while isinstance(array, np.ndarray) and not array.flags.writeable:
        array = array.base
    if not isinstance(array, np.ndarray):
        return data
    copied = np.array(data)
    copied.flags.writeable = False
    return copied


class Fingerprints:
    """Computes digests of records, and caches those of records that stay the same objects.

    Records are dataclasses and tuples whose content never changes. The cache keeps only the records
    that the last call met.
    """

    def __init__(self) -> None:
        self._known: dict[int, tuple[Any, Digest]] = {}
        self._met: dict[int, tuple[Any, Digest]] = {}

    def of(self, value: Any) -> Digest:
        """Return the digest of dataclasses, mappings, sequences, sets, arrays and plain values.

        Raises:
            TypeError: It contains an object of another type.
        """
        self._met = {}
        found = self._digest(value)
        self._known = self._met
        return found

    def forget(self) -> None:
        """Empty the cache."""
        self._known = {}

    def _digest(self, value: Any) -> Digest:
        if isinstance(value, tuple) or _is_record(value):
            return self._of_constant(value)
        if isinstance(value, np.ndarray):
            return _of_array(value)
        if isinstance(value, list):
            return _join("sequence", [self._digest(inner) for inner in value])
        if isinstance(value, (set, frozenset)):
            return _join("set", sorted(self._digest(inner) for inner in value))
        if isinstance(value, Mapping):
            pairs = [self._digest(key) + self._digest(inner) for key, inner in value.items()]
            return _join("mapping", sorted(pairs))
        return _of_plain(value)

    def _of_constant(self, value: Any) -> Digest:
        known = self._met.get(id(value)) or self._known.get(id(value))
        if known is None:
            if isinstance(value, tuple):
                kind, parts = "sequence", value
            else:
                kind = f"record {type(value).__module__}.{type(value).__qualname__}"
                parts = tuple(getattr(value, field.name) for field in dataclasses.fields(value))
            # Keep the value too, so that no other object can get its id.
            known = value, _join(kind, [self._digest(part) for part in parts])
        self._met[id(value)] = known
        return known[1]


def _is_record(value: Any) -> bool:
    return dataclasses.is_dataclass(value) and not isinstance(value, type)


def _join(kind: str, digests: list[Digest]) -> Digest:
    return _hash(f"{kind} {len(digests)} ".encode() + b"".join(digests))


def _of_array(array: Any) -> Digest:
    if array.dtype.hasobject:
        raise TypeError("an array of objects has no digest")
    data = np.ascontiguousarray(array).reshape(-1).view(np.uint8).data
    return _hash(f"array {array.dtype.str} {array.shape} ".encode(), data)


def _of_plain(value: Any) -> Digest:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return _hash(b"float " + struct.pack("<d", value))
    if value is None or isinstance(value, (bool, int, str, bytes, Path)):
        return _hash(f"{type(value).__name__} {value!r}".encode())
    raise TypeError(f"a {type(value).__name__} has no digest")


def _hash(*parts: Any) -> Digest:
    # The fastest of the standard library on processors with SHA instructions.
    found = hashlib.sha256()
    for part in parts:
        found.update(part)
    return found.digest()
