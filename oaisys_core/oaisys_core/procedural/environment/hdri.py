"""Sky images (HDRIs) and their label maps, read from files."""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.config.sections.environment import HdriConfig, HdriImageConfig, SkyLabelsConfig
from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.files.image_formats.color_spaces import check_exr_primaries, gamma_of
from oaisys_core.files.image_formats.image_use import SKY, SKY_LABELS
from oaisys_core.files.image_formats.images import decode_pixels, read_file, read_radiance_file
from oaisys_core.files.image_formats.label_images import LabelPixels, read_label_pixels
from oaisys_core.files.versions import Version, version_of
from oaisys_core.output.exr import read_channels
from oaisys_core.scene import id_of_level
from oaisys_core.scene.sky import SkyImage

LOG = logging.getLogger(__name__)

SUFFIXES = (".exr", ".hdr")
"""Images of radiance, which a folder of them is searched for."""

PHOTOGRAPHS = (".png", ".jpg", ".jpeg")
"""Panoramas in sRGB, which are only read where they are named."""

KEPT = 4
"""Number of images that stay loaded; one of 8192 x 4096 pixels takes 0.4 GB."""

MAX_KEPT = 2_000_000_000
"""Bytes of those that stay loaded besides the last."""

BRIGHTEST = 65504.0
"""Largest half float; it replaces infinite radiance."""

MOST_INVALID = 0.01
"""Share of pixels that may be NaN or infinite."""


Key = tuple[str, tuple[int, ...], tuple[Version, ...]]
"""What an image is made of: its configuration, ids of other directions, and its files."""


class SkyImages:
    """Loads sky images and caches the last few, so that an image used again is the same object.

    A file that has changed is read again.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[Key, SkyImage] = OrderedDict()

    def load(self, config: HdriImageConfig, other_ids: tuple[int, ...]) -> SkyImage:
        """Return an image with its labels.

        Args:
            config: The files of the image.
            other_ids: Ids by level of directions that the label maps leave out.

        Raises:
            InvalidInputError: A file cannot be read or is not equirectangular.
        """
        chosen = config.model_dump_json(include={"file", "labels_from"})
        key = (chosen, other_ids, _versions_of(config))
        if key not in self._kept:
            maps = _label_maps(config.labels_from, other_ids)
            radiance = read_radiance(config.file)
            self._kept[key] = SkyImage(config.file.stem, radiance, tuple(sorted(maps.items())))
        self._kept.move_to_end(key)
        while len(self._kept) > KEPT or (self._size_bytes() > MAX_KEPT and len(self._kept) > 1):
            self._kept.popitem(last=False)
        return self._kept[key]

    def _size_bytes(self) -> int:
        return sum(image.radiance.nbytes for image in self._kept.values())


def _versions_of(config: HdriImageConfig) -> tuple[Version, ...]:
    files = (config.file, *(labels.image for labels in config.labels_from))
    try:
        return tuple(version_of(file) for file in files)
    except OSError as error:
        expected = f"a file that is still there ({error.strerror})"
        raise InvalidInputError("environment.hdri", str(error.filename), expected) from None


def images_of(config: HdriConfig) -> tuple[HdriImageConfig, ...]:
    """Return the images to choose from; those of the folder come last.

    Raises:
        InvalidInputError: The folder has no image, or there is none named as in ``use``.
    """
    found = [] if config.folder is None else _files_in(config.folder)
    images = (*config.images, *(HdriImageConfig(file=file) for file in found))
    if config.use is not None and config.use not in [image.file.stem for image in images]:
        expected = one_of((image.file.stem for image in images), config.use)
        raise InvalidInputError("environment.hdri.use", config.use, expected)
    return images


def read_radiance(file: Path) -> NDArray[np.float32]:
    """Return the (H, 2H, 3) linear pixels of a panorama, top row first; 1 is white in a photograph.

    Raises:
        InvalidInputError: It cannot be read, or is not twice as wide as it is high.
    """
    kinds = {".exr": _read_exr, ".hdr": _read_hdr} | dict.fromkeys(PHOTOGRAPHS, _read_photograph)
    read = kinds.get(file.suffix.lower())
    if read is None:
        raise InvalidInputError("environment.hdri", str(file), f"a file {', '.join(kinds)}")
    pixels = read(file)
    _check_layout(file, pixels)
    radiance = np.ascontiguousarray(pixels, dtype=np.float32)
    _check_finite(file, radiance)
    # In place: a copy may take 1.6 GB.
    np.nan_to_num(radiance, copy=False, nan=0.0, posinf=BRIGHTEST, neginf=0.0)
    return np.maximum(radiance, 0.0, out=radiance)


def _check_finite(file: Path, radiance: NDArray[np.float32]) -> None:
    """Warn of the few invalid pixels that some published images contain; raise if they are many."""
    count = int((~np.isfinite(radiance).all(axis=-1)).sum())
    share = count / (radiance.shape[0] * radiance.shape[1])
    if share > MOST_INVALID:
        expected = f"finite radiance, but for at most {100 * MOST_INVALID:g} % of the pixels"
        shown = f"{file}: {100 * share:.3g} % of the pixels are not finite"
        raise InvalidInputError("environment.hdri", shown, expected)
    if count:
        LOG.warning(
            "%s: %d pixels are not finite; NaN becomes 0, infinity %g", file, count, BRIGHTEST
        )


def _read_hdr(file: Path) -> NDArray[Any]:
    return np.asarray(read_radiance_file(file, SKY)[..., ::-1])


def _read_photograph(file: Path) -> NDArray[Any]:
    data = read_file(file, SKY)
    pixels = decode_pixels(data, SKY, str(file))
    if pixels.dtype.kind != "u":
        raise InvalidInputError("environment.hdri", str(file), "pixels of 8 or 16 bits")
    gamma = gamma_of(data, str(file))
    LOG.warning(
        "%s: a photograph %s: what is white in it, such as the sun, has a radiance of 1, so"
        " the light is softer and weaker than outdoors",
        file, "in sRGB" if gamma is None else f"with a gamma of {gamma:g}",
    )  # fmt: skip
    shades = pixels[..., None] if pixels.ndim == 2 else pixels
    rgb = shades[..., 2::-1] if shades.shape[2] >= 3 else np.repeat(shades[..., :1], 3, axis=2)
    values = rgb / np.float32(np.iinfo(pixels.dtype).max)
    return linear(values) if gamma is None else values ** np.float32(1 / gamma)


def _read_exr(file: Path) -> NDArray[Any]:
    channels = read_channels(file, SKY)
    check_exr_primaries(file, SKY)
    is_grey = "Y" in channels and channels.keys() <= {"Y", "A"}
    names = ("Y", "Y", "Y") if is_grey else ("R", "G", "B")
    if not channels.keys() >= set(names):
        expected = f"channels R, G and B, or Y, not {', '.join(sorted(channels))}"
        raise InvalidInputError("environment.hdri", str(file), expected)
    return np.stack([channels[name] for name in names], axis=-1)


def _label_maps(
    sources: tuple[SkyLabelsConfig, ...], other_ids: tuple[int, ...]
) -> dict[int, NDArray[np.uint16]]:
    maps: dict[int, NDArray[np.uint16]] = {}
    for source in sources:
        pixels = read_label_pixels(source.image, SKY_LABELS)
        _check_layout(source.image, pixels.values)
        pixels.check_values(source.mapping, source.image, SKY_LABELS.field)
        wanted = {value: each.semantic_ids for value, each in source.mapping.items()}
        reach = max(len(ids) for ids in wanted.values())
        for step in range(reach):
            level = source.level + step
            start = maps.get(level)
            if start is None or start.shape != pixels.values.shape:
                other = id_of_level(other_ids, level)
                start = np.full(pixels.values.shape, other, np.uint16)
            maps[level] = _label(pixels, wanted, step, start)
    return maps


def _label(
    pixels: LabelPixels,
    wanted: Mapping[str, tuple[int, ...]],
    step: int,
    start: NDArray[np.uint16],
) -> NDArray[np.uint16]:
    result = start.copy()
    for value, ids in wanted.items():
        if step < len(ids):
            result[pixels.where(value)] = ids[step]
    return result


def _check_layout(file: Path, image: NDArray[Any]) -> None:
    rows, cols = image.shape[:2]
    if cols != 2 * rows:
        expected = f"an equirectangular image, twice as wide as it is high, not {cols} x {rows}"
        raise InvalidInputError("environment.hdri", str(file), expected)


def _files_in(folder: Path) -> list[Path]:
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    found = [file for file in files if file.suffix.lower() in SUFFIXES]
    if not found:
        expected = f"an existing folder with files {' or '.join(SUFFIXES)}"
        raise InvalidInputError("environment.hdri.folder", str(folder), expected)
    return found
