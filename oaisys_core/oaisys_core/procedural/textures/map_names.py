"""Which file of a folder is which map, by the names that libraries of textures give them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".bmp", ".webp"})
UNREAD = frozenset({".tga", ".dds", ".psd", ".ktx", ".ktx2", ".jp2", ".avif", ".heic"})
"""Images that are not read."""

COLOR, HEIGHT, NORMAL, ROUGHNESS, GLOSS = "colour", "height", "normals", "roughness", "gloss"
OCCLUSION, PACKED, METALLIC_ROUGHNESS = "occlusion", "packed", "metallic-roughness"
UNUSED = "unused"

WORDS = {
    COLOR: "diffuse diff albedo basecolor base-color basecolour base-colour color colour col"
    " albedo-transparency albedotransparency",
    HEIGHT: "displacement disp height heightmap bump",
    NORMAL: "normal normals norm nor nrm normalmap nmap normalgl normaldx norgl nordx nrmgl nrmdx",
    ROUGHNESS: "roughness rough rgh",
    GLOSS: "gloss glossiness glossy smoothness",
    OCCLUSION: "ao ambientocclusion ambient-occlusion occlusion occ",
    PACKED: "arm orm occlusion-roughness-metallic ao-roughness-metallic ao-rough-metal ord",
    METALLIC_ROUGHNESS: "metallic-roughness metal-rough metallicroughness",
    UNUSED: (
        "spec specular refl reflection metal metallic metalness mask opacity alpha emissive"
        " emission translucency translucent transmission cavity fuzz curvature thickness coat"
        " sheen anisotropy rma mra preview bent-normal bent-normals bentnormal bentnormals"
        " metallic-smoothness metallicsmoothness mask-map maskmap specular-color"
        " specular-smoothness specularsmoothness emissive-color emission-color"
    ),
}
"""Words by kind of map, the better first; a hyphen joins words that follow each other.

In a ``packed`` map red is occlusion, green roughness; in a ``metallic-roughness`` one green is
roughness. ``unused`` maps say nothing about ground, which is neither metallic nor specular.
"""

DIRECTX = frozenset({"dx", "directx", "d3d", "normaldx", "nordx", "nrmdx"})
OPENGL = frozenset({"gl", "ogl", "opengl", "normalgl", "norgl", "nrmgl"})

_PHRASES = {
    tuple(phrase.split("-")): (kind, rank)
    for kind, words in WORDS.items()
    for rank, phrase in enumerate(words.split())
}
_LONGEST = max(map(len, _PHRASES))
_PART = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")
_JOINED = (("direct", "x"), ("open", "gl"))
_SIZES = re.compile(r"[0-9]+|k|png|jpg|jpeg|exr|tif|tiff|blend|gltf")


@dataclass(frozen=True)
class MapFile:
    """An image whose name says what it shows.

    Attributes:
        path: The file.
        kind: One of `WORDS`.
        rank: Place of its word among those of the kind.
        convention: Of normals: ``dx`` (green points down), ``gl`` (up), or empty if no name tells.
        start: The words of its name before that.
    """

    path: Path
    kind: str
    rank: int
    convention: str
    start: tuple[str, ...]


@dataclass(frozen=True)
class FolderMaps:
    """The images of a texture folder.

    Attributes:
        used: By kind, without `UNUSED`.
        aside: What is not used, and why.
    """

    used: dict[str, MapFile]
    aside: dict[Path, str]

    def __str__(self) -> str:
        """Return what is used for what, and what is left aside."""
        used = ", ".join(f"{_shown(each)} {each.path.name}" for each in self.used.values())
        aside = ", ".join(f"{path.name} ({why})" for path, why in self.aside.items())
        return f"{used}; left aside: {aside}" if aside else used


def maps_in(folder: Path) -> FolderMaps:
    """Return which images of a folder are used.

    Of several of a kind, that whose name starts as the folder's is used, else as most names in the
    folder, else that with the better word, else the first by name.
    """
    # macOS puts files with a dot in front beside the true ones.
    images = sorted(each for each in folder.iterdir() if not each.name.startswith("."))
    files = [each for each in images if each.suffix.lower() in SUFFIXES]
    named = [found for file in files if (found := map_file(file)) is not None]
    starts = Counter(each.start for each in named)
    own = _without_sizes(_words(folder.name))

    def order(each: MapFile) -> tuple[bool, int, int, int, str]:
        foreign = not (own and each.start[: len(own)] == own)
        conventions = ("gl", "", "dx").index(each.convention)
        return foreign, -starts[each.start], conventions, each.rank, each.path.name

    used: dict[str, MapFile] = {}
    aside = dict.fromkeys(files, "no word of its name is known")
    for each in sorted(named, key=order):
        aside[each.path] = "ground has no such map"
        if each.kind in used:
            aside[each.path] = f"{used[each.kind].path.name} is used"
        elif each.kind != UNUSED:
            used[each.kind] = each
            del aside[each.path]
    for kind, others in ((GLOSS, (ROUGHNESS,)), *((each, _CONTENT[each]) for each in _CONTENT)):
        if kind in used and all(other in used for other in others):
            aside[used.pop(kind).path] = f"{used[others[0]].path.name} is used"
    for file in images:
        if file.suffix.lower() in UNREAD:
            aside[file] = f"{file.suffix} is not read: save it as PNG"
    return FolderMaps({kind: used[kind] for kind in WORDS if kind in used}, aside)


_CONTENT = {PACKED: (ROUGHNESS, OCCLUSION), METALLIC_ROUGHNESS: (ROUGHNESS,)}


def map_file(path: Path) -> MapFile | None:
    """Return what the last (and longest) known word in a file's name says; None without one."""
    words = _words(path.stem)
    best: tuple[int, int] = (-1, 0)
    found: tuple[str, int] | None = None
    for place, phrase in _runs(words):
        if phrase in _PHRASES and (place + len(phrase), len(phrase)) > best:
            best, found = (place + len(phrase), len(phrase)), _PHRASES[phrase]
    if found is None:
        return None
    kind, rank = found
    convention = ""
    if kind == NORMAL:
        convention = "dx" if DIRECTX & {*words} else "gl" if OPENGL & {*words} else ""
    return MapFile(path, kind, rank, convention, _without_sizes(words[: best[0] - best[1]]))


def _runs(words: Sequence[str]) -> Iterator[tuple[int, tuple[str, ...]]]:
    for place in range(len(words)):
        for length in range(1, _LONGEST + 1):
            yield place, tuple(words[place : place + length])


def _words(name: str) -> tuple[str, ...]:
    """Return the words of a name in lower case, also those that capitals alone set apart."""
    words = [part.lower() for part in _PART.findall(name)]
    for first, second in _JOINED:
        for place in range(len(words) - 2, -1, -1):
            if (words[place], words[place + 1]) == (first, second):
                words[place : place + 2] = [first + second]
    return tuple(words)


def _without_sizes(words: tuple[str, ...]) -> tuple[str, ...]:
    """Return words without those at the end that say a size or a format, such as 4k and png."""
    while words and _SIZES.fullmatch(words[-1]):
        words = words[:-1]
    return words


def _shown(each: MapFile) -> str:
    if each.kind != NORMAL:
        return each.kind
    told = {
        "dx": "DirectX's, green turned",
        "gl": "OpenGL's",
        "": "OpenGL's, if no height map shows otherwise",
    }
    return f"{each.kind} ({told[each.convention]})"
