"""What a format of data sets is, and the conventions that all formats share.

A package adds a format through the entry point group ``oaisys.dataset_formats``: a subclass of
`DatasetFormat` that can be made without arguments. `oaisys_dataset.formats.export` calls it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from oaisys_core import extensions
from oaisys_core.errors import ConfigError, InvalidInputError, one_of
from oaisys_core.files.names import path_inside

if TYPE_CHECKING:
    from oaisys_dataset.reader import Dataset, DatasetSample

WRITTEN_SCANS, LEFT_OUT_SCANS = "lidar scans", "lidar scans, left out"
"""Names of the counts of scans that a format writes, and that it does not."""

FRAMES_WITHOUT = "frames without"
"""Begins the names of the counts of frames that lack what a format needs."""


@dataclass(frozen=True)
class FormatConventions:
    """What a reader of an export must know; written as its README.md, in Markdown.

    The defaults are the conventions of the simulator; a format states what differs.

    Attributes:
        layout: Which file holds what.
        reading: How a program opens it, best as a few lines of Python in a fence.
        camera_axes: Axes of a camera's frame.
        world_axes: Axes of the world's frame, and its unit.
        poses: What a pose transforms into what, and how rotations are written.
        pixels: Where pixel centres are.
        depth: What depth is, its unit and type.
        no_hit: What ``+inf`` becomes, the depth where nothing is hit.
        labels: What label and instance ids are.
        color: What colour is.
    """

    layout: str
    reading: str = ""
    camera_axes: str = "x right, y down, z forward (OpenCV; the optical frame of REP-103)"
    world_axes: str = "`map`: right-handed, z up, metres; the origin is the centre of the stage"
    poses: str = (
        "`T_map_camera` is a 4x4 matrix that takes points from the camera's frame to `map`: "
        "X_map = T_map_camera X_camera"
    )
    pixels: str = (
        "the centre of the first pixel is (0, 0), as in OpenCV and ROS; a centred 640x480 camera "
        "has its principal point at (319.5, 239.5)"
    )
    depth: str = "planar z in metres, float32, sampled through the pixel's centre, never smoothed"
    no_hit: str = "`+inf` stays `+inf`: nothing was hit there (REP-117)"
    labels: str = (
        "`semantic_N` holds the label id of level N, 0 is unlabelled; `instance` holds object ids, "
        "unique in a world, 0 is no object. Ids are never blended"
    )
    color: str = "sRGB, 8 bits"


@dataclass(frozen=True)
class ExportOptions:
    """What a caller chooses about an export.

    Attributes:
        settings: Values of the format's own settings (`DatasetFormat.settings`), as text.
        license: Licence of the data set: a name of the SPDX list, a URL or free text.
        price_per_hour: Price of one worker for an hour, for the data card; None for none.
        progress: Called with the number of frames written so far.
    """

    settings: Mapping[str, str] = field(default_factory=dict)
    license: str = ""
    price_per_hour: float | None = None
    progress: Callable[[int], None] = field(default=lambda _: None)

    def number(self, name: str, default: float, least: float = 0.0) -> float:
        """Return a setting as a number.

        Raises:
            InvalidInputError: It is not a finite number of at least ``least``.
        """
        text = self.settings.get(name)
        if text is None:
            return float(default)
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not (value >= least and isfinite(value)):
            expected = f"a finite number of at least {least:g}"
            raise InvalidInputError(f"settings.{name}", text, expected)
        return value

    def count(self, name: str, default: int, least: int = 0) -> int:
        """Return a setting as a whole number.

        Raises:
            InvalidInputError: It is not a whole number of at least ``least``.
        """
        value = self.number(name, default, least)
        if not value.is_integer():
            expected = f"a whole number of at least {least}"
            raise InvalidInputError(f"settings.{name}", self.settings[name], expected)
        return int(value)

    def choice(self, name: str, allowed: Sequence[str]) -> str:
        """Return a setting that is one of some words; the first is the default.

        Raises:
            InvalidInputError: It is another one.
        """
        text = self.settings.get(name, allowed[0])
        if text not in allowed:
            raise InvalidInputError(f"settings.{name}", text, one_of(allowed, text))
        return text


class DatasetFormat(ABC):
    """Writes a data set in the layout that other programs read.

    Attributes:
        name: Name of the format, that of its entry point.
        modalities: Images without which the format has no content.
        settings: What each setting means, by name.
        images_beside: Images that it writes where a frame has them; README.md counts the frames
            that have not.
        writes_scans: Whether it writes lidar scans; otherwise README.md counts them as left out.
        conventions: What README.md says about an export.
        has_fisheye: Whether it can describe fisheye cameras; data sets with them are refused
            otherwise.
    """

    name: ClassVar[str]
    modalities: ClassVar[tuple[str, ...]] = ()
    images_beside: ClassVar[tuple[str, ...]] = ()
    settings: ClassVar[Mapping[str, str]] = {}
    writes_scans: ClassVar[bool] = False
    conventions: ClassVar[FormatConventions]
    has_fisheye: ClassVar[bool] = False

    def images_needed(self, options: ExportOptions) -> tuple[str, ...]:
        """Return the images without which a frame is left out, which README.md counts.

        Args:
            options: The caller's choices.
        """
        return ()

    @abstractmethod
    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """Write the whole data set into an empty folder.

        The caller makes the folder, moves it to its final place when this method returns, and adds
        README.md, the Croissant metadata and the data card. An `OSError` may pass through.

        Returns:
            How many of what were written or left out, with readable names such as ``frames``.

        Raises:
            InvalidInputError: The data set or a setting does not suit this format.
        """


def write_file(folder: Path, name: str, data: bytes) -> None:
    """Write a new file of an export; its folders are made.

    Args:
        folder: Of the export, or in it.
        name: Of the file in it, see `path_inside`.
        data: Its content.

    Raises:
        InvalidInputError: It is no name of a file, or the export has such a file already.
    """
    path = path_inside(folder, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with path.open("xb") as file:
            file.write(data)
    except FileExistsError as error:
        expected = "a name, or a time in it, that no other frame has"
        raise InvalidInputError("name of a file", name, expected) from error


def format_names() -> list[str]:
    """Return the names of all installed formats."""
    return sorted(extensions.names(extensions.DATASET_FORMATS))


def format_named(name: str) -> DatasetFormat:
    """Return a format by its name.

    Raises:
        InvalidInputError: No such format is installed.
        ConfigError: It cannot be imported, or is not a `DatasetFormat`.
    """
    if name not in format_names():
        raise InvalidInputError("format", name, one_of(format_names(), name))
    found = extensions.load(extensions.DATASET_FORMATS, name)
    if not (isinstance(found, type) and issubclass(found, DatasetFormat)):
        group = extensions.DATASET_FORMATS
        raise ConfigError(f"{group}: {name!r} is {found!r}, expected a subclass of DatasetFormat")
    return found()


def check_suits(
    chosen: DatasetFormat, modalities: Collection[str], fisheyes: Collection[str]
) -> None:
    """Raise if a data set with some modalities and fisheye cameras does not suit a format.

    Raises:
        InvalidInputError: The format would have no content, or cannot describe a camera.
    """
    if fisheyes and not chosen.has_fisheye:
        able = [name for name in format_names() if format_named(name).has_fisheye]
        expected = f"no fisheye cameras, which {chosen.name} cannot describe; {', '.join(able)} can"
        raise InvalidInputError("sensors", ", ".join(sorted(fisheyes)), expected)
    missing = sorted(set(chosen.modalities) - set(modalities))
    if missing:
        expected = f"also {', '.join(missing)}, without which {chosen.name} has no content"
        raise InvalidInputError("modalities", ", ".join(sorted(modalities)), expected)


def modality_names(dataset: Dataset) -> list[str]:
    """Return the modalities that any frame has, sorted."""
    return sorted({modality for record in dataset.records for modality in record.images})


def complete_samples(
    dataset: Dataset, modalities: Sequence[str], counts: Counter[str]
) -> Iterator[DatasetSample]:
    """Yield the samples that have all of some modalities, with these alone; count the others."""
    for record in dataset.records:
        if set(modalities) <= set(record.images):
            yield dataset.sample(record, modalities)
        else:
            counts[frames_without_images(modalities)] += 1


def frames_without_images(modalities: Sequence[str]) -> str:
    """Return the name of the count of frames that lack one of some images."""
    return f"{FRAMES_WITHOUT} {', '.join(modalities)}, left out"


def label_names(dataset: Dataset) -> dict[int, str]:
    """Return the name of each label id; names that differ between worlds are joined by `` / ``."""
    names: dict[int, dict[str, None]] = {}
    for world in dataset.worlds:
        for label_id, name in dataset.legend(world).labels.items():
            names.setdefault(label_id, {})[name] = None
    return {label_id: " / ".join(names[label_id]) for label_id in sorted(names)}


def thing_ids(dataset: Dataset) -> set[int]:
    """Return the ids of the labels that objects have in any world, without 0 (no label)."""
    return {
        thing.semantic_id
        for world in dataset.worlds
        for thing in dataset.legend(world).instances.values()
    } - {0}
