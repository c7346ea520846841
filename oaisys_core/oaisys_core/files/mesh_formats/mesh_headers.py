"""Checks of mesh files before they are read: what their headers announce must be in them."""

from __future__ import annotations

import base64
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from oaisys_core.errors import InvalidInputError, quote
from oaisys_core.files.documents import parse_json, read_bytes
from oaisys_core.files.mesh_formats.gltf_structure import check_structure
from oaisys_core.files.mesh_formats.mesh_texts import check_ply_text, check_stl_text

MAX_BYTES = 2_000_000_000
"""Size of a binary mesh file, and of a file that it refers to."""

MAX_TEXT_BYTES = 500_000_000
"""Size of a mesh file that is text: reading takes twenty times as much memory."""

MAX_VERTICES = 20_000_000
"""Vertices, and triangles, of a mesh; each instance in a glTF scene counts."""

MAX_MAP_VERTICES = 400_000_000
MAX_MAP_BYTES = 16_000_000_000
"""Likewise of the maps and true meshes that an evaluation reads."""

MAX_NODES = 100_000
MAX_NODE_DEPTH = 200
MAX_HEADER_BYTES = 65_536
"""Within which the header of a .ply file ends."""

LEAST_STRIDE, MOST_STRIDE = 4, 252
"""Bytes from one vertex to the next in a glTF file (glTF 2.0, §5.11.4)."""

_ELEMENT_COUNT = re.compile(rb"-?[0-9]{1,20}")

_PLY_TYPES = {
    **dict.fromkeys((b"char", b"uchar", b"int8", b"uint8"), 1),
    **dict.fromkeys((b"short", b"ushort", b"int16", b"uint16"), 2),
    **dict.fromkeys((b"int", b"uint", b"float", b"int32", b"uint32", b"float32"), 4),
    **dict.fromkeys((b"double", b"float64"), 8),
}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}


def check_mesh_file(
    path: Path, field: str, *, most_bytes: int = MAX_BYTES, most_elements: int = MAX_VERTICES
) -> None:
    """Raise if a mesh file is too large, or announces more than it contains.

    Args:
        path: The file.
        field: Name of the file's field in errors.
        most_bytes: Size of a binary file.
        most_elements: Vertices, and triangles, that a PLY or STL file may announce.

    Raises:
        InvalidInputError: With the file, the size and the bound.
    """
    size = path.stat().st_size
    suffix = path.suffix.lower()
    try:
        with path.open("rb") as file:
            start = file.read(MAX_HEADER_BYTES)
        most = MAX_TEXT_BYTES if _is_text(suffix, start) else most_bytes
        if size > most:
            raise ValueError(f"at most {most} bytes, not {size}")
        if start.startswith(b"ply"):
            _check_ply(start, size, most_elements)
            if _is_text(".ply", start):
                check_ply_text(path, start)
        elif suffix == ".stl" and _is_text(suffix, start):
            check_stl_text(path)
        elif suffix == ".stl":
            _check_stl(start, size, most_elements)
    except OSError as error:
        expected = f"a file that can be read ({error.strerror})"
        raise InvalidInputError(field, str(path), expected) from error
    except (ValueError, struct.error) as error:
        raise InvalidInputError(field, str(path), f"a {suffix} file of {error}") from error


def check_map_file(path: Path, field: str) -> None:
    """Raise likewise for the file of a map, or of a true mesh, which may be larger.

    Raises:
        InvalidInputError: With the file, the size and the bound.
    """
    check_mesh_file(path, field, most_bytes=MAX_MAP_BYTES, most_elements=MAX_MAP_VERTICES)


def is_text_stl(path: Path) -> bool:
    """Return whether a .stl file is text."""
    with path.open("rb") as file:
        return _is_text(".stl", file.read(MAX_HEADER_BYTES))


def is_text_ply(path: Path) -> bool:
    """Return whether a file is a .ply file of text."""
    with path.open("rb") as file:
        return path.suffix.lower() == ".ply" and _is_text(".ply", file.read(MAX_HEADER_BYTES))


def _is_text(suffix: str, start: bytes) -> bool:
    if suffix == ".ply":
        header = start.partition(b"\nend_header")[0]
        return re.search(rb"(?m)^format[ \t]+ascii\b", header) is not None
    if suffix == ".stl":
        # Binary files may begin so, too, but their counts have zeros.
        return start.lstrip().lower().startswith(b"solid") and b"\0" not in start
    return suffix in (".obj", ".gltf")


def _check_ply(start: bytes, size: int, most: int) -> None:
    end = re.search(rb"\nend_header\r?\n", start)
    if end is None:
        raise ValueError(f"a header within {MAX_HEADER_BYTES} bytes")
    is_text = _is_text(".ply", start)
    announced = 0
    elements = re.split(rb"\nelement ", start[: end.start()])[1:]
    for element in elements:
        lines = element.splitlines()
        name, number = _name_and_count(lines[0])
        row = max(1, sum(_ply_bytes(line, is_text) for line in lines[1:]))
        if not 0 <= number <= most:
            raise ValueError(f"at most {most} of an element, not {number} {name.decode()}")
        announced += number * row
    # The last number of a text needs no space after it.
    if announced > size + 1:
        expected = f"as many elements as fit into its {size} bytes (is it truncated?)"
        raise ValueError(f"{expected}, not {announced} bytes")


def _name_and_count(line: bytes) -> tuple[bytes, int]:
    words = line.split()
    if len(words) != 2 or not _ELEMENT_COUNT.fullmatch(words[1]):
        raise ValueError("a header that names each element with its number")
    return words[0], int(words[1])


def _ply_bytes(line: bytes, is_text: bool) -> int:
    """Return how many bytes a property takes at least."""
    words = line.split()
    if not words or words[0] != b"property":
        return 0
    if len(words) != (5 if words[1:2] == [b"list"] else 3):
        shown = quote(line.decode("utf-8", errors="replace"))
        raise ValueError(f"a header with the type and name of each property, not {shown}")
    if is_text:
        return 2
    return _PLY_TYPES.get(words[2] if words[1] == b"list" else words[1], 1)


def _check_stl(start: bytes, size: int, most: int) -> None:
    (count,) = struct.unpack_from("<I", start, 80)
    if count > most:
        raise ValueError(f"at most {most} triangles, not {count}")
    if 84 + 50 * count != size:
        raise ValueError(f"{84 + 50 * count} bytes for its {count} triangles, not {size}")


# glTF -------------------------------------------------------------------------------------------


def read_gltf(path: Path, field: str) -> tuple[Mapping[str, Any], bytes]:
    """Return the document of a ``.gltf`` or ``.glb`` file, checked, and the binary part of a .glb.

    Raises:
        InvalidInputError: It cannot be read, or announces more than it contains.
    """
    try:
        data = read_bytes(path, MAX_BYTES)
        text, binary = _glb_parts(data) if data.startswith(b"glTF") else (data, b"")
        document = parse_json(text)
        if not isinstance(document, dict):
            raise ValueError("it is not a JSON object")  # noqa: TRY004  # about the file
        check_structure(document)
        _check_gltf(document)
    except (OSError, ValueError, KeyError, TypeError, struct.error) as error:
        expected = f"a glTF file that can be used ({error})"
        raise InvalidInputError(field, str(path), expected) from error
    return document, binary


def _glb_parts(data: bytes) -> tuple[bytes, bytes]:
    (length,) = struct.unpack_from("<I", data, 12)
    if data[16:20] != b"JSON":
        raise ValueError("its first part is not JSON")
    text, rest = _chunk(data, 20, length, "JSON")
    if len(rest) < 8:
        return text, b""
    (length,) = struct.unpack_from("<I", rest)
    if rest[4:8] != b"BIN\0":
        raise ValueError("its second part is not binary")
    return text, _chunk(rest, 8, length, "binary")[0]


def _chunk(data: bytes, start: int, length: int, name: str) -> tuple[bytes, bytes]:
    """Return a part of a .glb file that begins somewhere, and what follows it."""
    left = len(data) - start
    if length > left:
        raise ValueError(f"its {name} part announces {length} bytes, and {left} are left")
    return data[start : start + length], data[start + length :]


def _entries(document: Mapping[str, Any], name: str) -> Sequence[Mapping[str, Any]]:
    found = document.get(name, [])
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise ValueError(f"{name} is not a list of objects")
    return found


def _count(entry: Mapping[str, Any], name: str, default: int | None = None) -> int:
    value = entry.get(name, default)
    if not isinstance(value, int) or value < 0:
        raise ValueError(f"{name} is not a whole number of 0 or more")
    return value


def _check_gltf(document: Mapping[str, Any]) -> None:
    views = _entries(document, "bufferViews")
    for index, view in enumerate(views):
        stride = view.get("byteStride")
        if stride is not None and not LEAST_STRIDE <= stride <= MOST_STRIDE:
            expected = f"a byteStride from {LEAST_STRIDE} to {MOST_STRIDE}"
            raise ValueError(f"{expected} in buffer view {index}, not {stride}")
    values = 0
    for accessor in _entries(document, "accessors"):
        count = _count(accessor, "count")
        if count > 3 * MAX_VERTICES:
            raise ValueError(f"an accessor of at most {3 * MAX_VERTICES} elements, not {count}")
        components = _COMPONENTS.get(str(accessor.get("type")), 16)
        values += count * components
        if "bufferView" in accessor:
            view = views[_count(accessor, "bufferView")]
            needed = count * components * _COMPONENT_BYTES.get(accessor.get("componentType", 0), 1)
            if not view.get("byteStride") and needed > _count(view, "byteLength"):
                raise ValueError(f"an accessor of {count} elements is larger than its view")
    if values > 32 * MAX_VERTICES:
        raise ValueError(f"accessors of at most {32 * MAX_VERTICES} numbers, not {values}")
    for buffer in _entries(document, "buffers"):
        if _count(buffer, "byteLength", 0) > MAX_BYTES:
            raise ValueError(f"a buffer of at most {MAX_BYTES} bytes")
    _check_nodes(_entries(document, "nodes"))


def _check_nodes(nodes: Sequence[Mapping[str, Any]]) -> None:
    if len(nodes) > MAX_NODES:
        raise ValueError(f"at most {MAX_NODES} nodes, not {len(nodes)}")
    children = [tuple(node.get("children", ())) for node in nodes]
    below = [child for each in children for child in each]
    if len(set(below)) < len(below) or any(not 0 <= child < len(nodes) for child in below):
        raise ValueError("nodes that are no trees")
    inner = set(below)
    level, depth, reached = [n for n in range(len(nodes)) if n not in inner], 0, 0
    while level:
        depth += 1
        reached += len(level)
        if depth > MAX_NODE_DEPTH:
            raise ValueError(f"nodes nested at most {MAX_NODE_DEPTH} times")
        level = [child for node in level for child in children[node]]
    if reached < len(nodes):
        raise ValueError("nodes that are no trees")


def inner_images(document: Mapping[str, Any], binary: bytes) -> Iterator[tuple[str, bytes]]:
    """Yield name and bytes of the images within a glTF file itself."""
    views = _entries(document, "bufferViews")
    for number, image in enumerate(_entries(document, "images")):
        name = str(image.get("name", f"image {number}"))
        uri = str(image.get("uri", ""))
        if uri.startswith("data:"):
            yield name, base64.b64decode(uri.partition(",")[2])
        elif "bufferView" in image:
            view = views[_count(image, "bufferView")]
            start = _count(view, "byteOffset", 0)
            if _count(view, "buffer", 0) == 0 and binary:
                yield name, binary[start : start + _count(view, "byteLength")]
