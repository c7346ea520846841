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
OCCLUSION, PACKED = "occlusion", "packed"
UNUSED = "unused"

CHANNELS = {
    "arm": (OCCLUSION, ROUGHNESS),
    "orm": (OCCLUSION, ROUGHNESS),
    "occlusion-roughness-metallic": (OCCLUSION, ROUGHNESS),
    "occlusionroughnessmetallic": (OCCLUSION, ROUGHNESS),
    "ao-roughness-metallic": (OCCLUSION, ROUGHNESS),
    "ao-rough-metal": (OCCLUSION, ROUGHNESS),
    "ord": (OCCLUSION, ROUGHNESS, HEIGHT),
    "ordp": (OCCLUSION, ROUGHNESS, HEIGHT),
    "rma": (ROUGHNESS, "", OCCLUSION),
    "mra": ("", ROUGHNESS, OCCLUSION),
    "mrao": ("", ROUGHNESS, OCCLUSION),
    "metallic-roughness": ("", ROUGHNESS),
    "metallicroughness": ("", ROUGHNESS),
    "metal-rough": ("", ROUGHNESS),
    "mask-map": ("", OCCLUSION, "", GLOSS),
    "maskmap": ("", OCCLUSION, "", GLOSS),
    "metallic-smoothness": ("", "", "", GLOSS),
    "metallicsmoothness": ("", "", "", GLOSS),
    "specular-smoothness": ("", "", "", GLOSS),
    "specularsmoothness": ("", "", "", GLOSS),
}
"""What red, green, blue and alpha of a packed map are, by the word that names it: of Poly Haven and
glTF (ARM, ORM), Quixel (ORD), Unreal and Source (RMA, MRA), Unity (mask map, metallic smoothness).
Empty is what ground does not have, such as metalness."""

WORDS = {
    COLOR: "diffuse diff albedo basecolor base-color basecolour base-colour color colour col"
    " albedo-transparency albedotransparency",
    HEIGHT: "displacement disp height heightmap bump",
    NORMAL: "normal normals norm nor nrm normalmap nmap normalgl normaldx norgl nordx nrmgl nrmdx",
    ROUGHNESS: "roughness rough rgh",
    GLOSS: "gloss glossiness glossy smoothness",
    OCCLUSION: "ao ambientocclusion ambient-occlusion occlusion occ",
    PACKED: " ".join(CHANNELS),
    UNUSED: (
        "spec specular refl reflection metal metallic metalness mask opacity alpha emissive"
        " emission translucency translucent transmission cavity fuzz curvature thickness coat"
        " sheen anisotropy preview bent-normal bent-normals bentnormal bentnormals"
        " specular-color"
        " emissive-color emission-color"
    ),
}
"""Words by kind of map, the better first; a hyphen joins words that follow each other.

``unused`` maps say nothing about ground, which is neither metallic nor specular.
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
        channels: What the channels of a packed map are, see `CHANNELS`.
    """

    path: Path
    kind: str
    rank: int
    convention: str
    start: tuple[str, ...]
    channels: tuple[str, ...] = ()


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
    """Return which images of a folder are used, or, if it has none, of its folder ``textures``.

    Of several of a kind, that whose name starts as the folder's is used, else as most names in the
    folder, else that with the better word, else the first by name.
    """
    images = _images_in(folder) or _images_in(folder / "textures")
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
    for kind in (GLOSS, PACKED):
        if kind in used and (others := _substitutes(used[kind], used)):
            aside[used.pop(kind).path] = f"{others[0].path.name} is used"
    for file in images:
        if file.suffix.lower() in UNREAD:
            aside[file] = f"{file.suffix} is not read: save it as PNG"
    return FolderMaps({kind: used[kind] for kind in WORDS if kind in used}, aside)


def _images_in(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    # macOS puts files with a dot in front beside the true ones.
    visible = (each for each in folder.iterdir() if not each.name.startswith("."))
    return sorted(each for each in visible if each.suffix.lower() in SUFFIXES | UNREAD)


def _substitutes(each: MapFile, used: dict[str, MapFile]) -> list[MapFile]:
    """Return the maps that say all that a gloss map or a packed one says; none if they do not."""
    found = []
    for content in filter(None, each.channels or (each.kind,)):
        kinds = [ROUGHNESS, GLOSS] if content in (ROUGHNESS, GLOSS) else [content]
        others = [used[kind] for kind in kinds if kind in used and used[kind] is not each]
        if not others:
            return []
        found.append(others[0])
    return found


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
    start = best[0] - best[1]
    channels = CHANNELS["-".join(words[start : best[0]])] if kind == PACKED else ()
    return MapFile(path, kind, rank, convention, _without_sizes(words[:start]), channels)


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
    if each.kind == PACKED:
        return " and ".join(filter(None, each.channels))
    if each.kind != NORMAL:
        return each.kind
    told = {
        "dx": "DirectX's, green turned",
        "gl": "OpenGL's",
        "": "OpenGL's, if no height map shows otherwise",
    }
    return f"{each.kind} ({told[each.convention]})"
