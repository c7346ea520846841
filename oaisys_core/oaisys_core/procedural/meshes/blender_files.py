"""Meshes of .blend, COLLADA and USD files, which Blender reads in a process of its own."""

from __future__ import annotations

import json
import logging
import re
import signal
import subprocess
import time
from collections import OrderedDict
from pathlib import Path
from typing import IO, Any

from numpy.typing import NDArray

from oaisys_core.errors import BackendUnavailableError, InvalidInputError
from oaisys_core.files.arrays import load_arrays
from oaisys_core.files.mesh_formats.mesh_headers import MAX_VERTICES
from oaisys_core.files.path_fields import is_confined
from oaisys_core.files.references import folders_of, outside_error
from oaisys_core.files.versions import Version, version_of
from oaisys_core.procedural.meshes.checks import check_mesh, check_uv
from oaisys_core.procedural.meshes.loaded import LoadedMesh
from oaisys_core.procedural.meshes.mesh_arrays import mesh_from_arrays
from oaisys_core.system.ending.interruption import stop_if_unwanted
from oaisys_core.system.ending.leftovers import temporary_folder
from oaisys_core.system.ending.owner import owner_variables
from oaisys_core.system.program_output import last_lines
from oaisys_core.system.python_programs import python_command, python_environment

LOG = logging.getLogger(__name__)

BLENDER_SUFFIXES = (".blend", ".dae", ".usd", ".usda", ".usdc", ".usdz")

BLEND_TIMEOUT_S = 120.0
"""For a file that the configuration names."""

BLEND_REQUEST_TIMEOUT_S = 15.0
"""For one that a request names: other clients wait as long."""

MAX_BLEND_BYTES = 4_000_000_000
"""Size of the arrays of a mesh."""

READER_MEMORY_BYTES = 8_000_000_000
"""What reading a file may take."""

SLOW_S = 2.0
"""A file that is refused after so long is refused at once from then on."""

MOST_WARNINGS = 20
"""Of a file."""

LOG_NAME = "log"
"""Of what a reader prints, in its folder."""

MODIFIER_FAULT = re.compile(r'Object: "(.*)", Modifier: "(.*)", (.*)')
"""What Blender prints of a modifier that it leaves out."""

MAX_REFUSED = 64
LOOK_S = 0.05
_refused: OrderedDict[Version, str] = OrderedDict()
"""Such files, by path, time and size, and what was expected of them."""


def load_by_blender(path: Path, object_name: str | None, field: str) -> LoadedMesh | list[str]:
    """Return the mesh of a file that Blender reads, or of one object in it.

    Args:
        path: The file.
        object_name: Name of the object; None for all objects.
        field: Name of the file's field in errors.

    Returns:
        The mesh; or the names of all objects with triangles, if none has that name.

    Raises:
        InvalidInputError: The file cannot be read, refers to files elsewhere, or is drawn anew
            each time.
        BackendUnavailableError: ``bpy`` is not installed, or has no importer of the format.
    """
    with temporary_folder("oaisys-") as folder:
        found = _read_blend(path, object_name, field, folder)
        refused = _refused_modifiers(last_lines(folder / LOG_NAME), object_name)
    if "outside" in found:
        raise outside_error(path, str(found["outside"]), field)
    if "names" in found:
        return [str(name) for name in found["names"].tolist()]
    if "random" in found:
        raise InvalidInputError(field, str(path), str(found["random"]))
    if "invalid" in found:
        expected = f"a {path.suffix} file with {found['invalid']}"
        raise InvalidInputError(field, str(path), expected)
    if "importer" in found:
        raise BackendUnavailableError(f"{field}: {path}: {found['importer']}")
    told = [*found["warnings"].tolist(), *refused]
    for text in told[:MOST_WARNINGS]:
        LOG.warning("%s: %s", path, text)
    if len(told) > MOST_WARNINGS:
        LOG.warning("%s: %d more warnings", path, len(told) - MOST_WARNINGS)
    if max(len(found["vertices_m"]), len(found["triangles"])) > MAX_VERTICES:
        expected = f"at most {MAX_VERTICES} vertices and triangles, not {len(found['triangles'])}"
        raise InvalidInputError(field, str(path), expected)
    check_mesh(found["vertices_m"], found["triangles"], path, field)
    check_uv([found.get("uv")], path, field)
    return mesh_from_arrays(object_name or path.stem, found)


def _read_blend(
    path: Path, object_name: str | None, field: str, folder: Path
) -> dict[str, NDArray[Any]]:
    """Return what a process of its own finds in a file."""
    out, log = folder / "mesh.npz", folder / LOG_NAME
    time_s = BLEND_REQUEST_TIMEOUT_S if is_confined() else BLEND_TIMEOUT_S
    task = {
        "file": str(path.resolve()),
        "object_name": object_name or "",
        "out": str(out),
        "folders": [str(each) for each in folders_of(path)],
        "time_s": int(time_s) + 5,
        "memory_bytes": READER_MEMORY_BYTES,
    }
    command = python_command("oaisys_core.render.blender.blend_program", json.dumps(task))
    version = version_of(path)
    if version in _refused:
        raise InvalidInputError(field, str(path), _refused[version])
    begun_s = time.monotonic()
    with log.open("wb") as output:
        try:
            code = _code_of(command, output, folder, time_s)
        except subprocess.TimeoutExpired as error:
            expected = f"a {path.suffix} file that loads within {time_s:g} s"
            _remember(version, expected)
            raise InvalidInputError(field, str(path), expected) from error
    if not code and out.exists():
        return load_arrays(out, MAX_BLEND_BYTES)
    said = next((line for line in reversed(last_lines(log)) if "Error" in line), "no message")
    if "BackendUnavailableError" in said or "No module named 'bpy'" in said:
        raise BackendUnavailableError(f"{field}: {path} needs Blender: bpy is not installed")
    expected = f"a readable {path.suffix} file ({_reason(code, said)})"
    if time.monotonic() - begun_s >= SLOW_S:
        _remember(version, expected)
    raise InvalidInputError(field, str(path), expected)


def _refused_modifiers(lines: list[str], object_name: str | None) -> list[str]:
    """Return a warning for each modifier that Blender left out, from the lines that it printed."""
    found = [match.groups() for line in lines if (match := MODIFIER_FAULT.search(line))]
    return [
        f"Blender leaves out the modifier {name!r} of {thing!r}: {reason}"
        for thing, name, reason in dict.fromkeys(found)
        if object_name in (None, thing)
    ]


def _remember(version: Version, expected: str) -> None:
    """Have a file refused at once from now on: each time, others wait for its reader."""
    _refused[version] = expected
    while len(_refused) > MAX_REFUSED:
        _refused.popitem(last=False)


def _reason(code: int, said: str) -> str:
    """Return why a reader found nothing, from its exit code and its last error."""
    if code < 0:
        name = signal.Signals(-code).name
        return f"its reader, which may take {READER_MEMORY_BYTES} bytes, was ended by {name}"
    return said.rpartition(f".{InvalidInputError.__name__}: ")[2]


def _code_of(command: list[str], output: IO[bytes], folder: Path, time_s: float) -> int:
    """Run the reader and return its exit code; it is killed once nobody wants what it finds."""
    owner = owner_variables(signal.SIGKILL)
    environment = {**python_environment(), **owner, "TMPDIR": str(folder)}
    process = subprocess.Popen(
        command, env=environment, stdin=subprocess.DEVNULL, stdout=output, stderr=output
    )
    deadline_s = time.monotonic() + time_s
    try:
        while True:
            stop_if_unwanted()
            left_s = deadline_s - time.monotonic()
            try:
                return process.wait(min(max(left_s, 0.0), LOOK_S))
            except subprocess.TimeoutExpired:
                if left_s <= 0:
                    raise
    finally:
        process.kill()
        process.wait()
