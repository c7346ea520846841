"""three.js for embedding in a page: its modules and its licence.

It is not part of this repository: `make setup` installs it with npm. Without it, reports contain
pictures of the mesh only.
"""

from __future__ import annotations

import base64
import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path

FOLDER_VARIABLE = "OAISYS_THREE"
"""Environment variable with another folder of the npm package ``three``."""

CORE, CORE_MODULE = "./three.core.min.js", "three/core"
"""The path by which three.js imports its core, and the module name that replaces it in a page."""

FILES = {
    "three": "build/three.module.min.js",
    CORE_MODULE: "build/three.core.min.js",
    "three/OrbitControls": "examples/jsm/controls/OrbitControls.js",
}
"""Files by the module names under which they are imported."""


@dataclass(frozen=True)
class ThreeJs:
    """The embeddable parts of three.js.

    Attributes:
        version: Version of the npm package.
        import_map: JSON for a ``script`` of type ``importmap``, with the modules as ``data:`` URLs.
        licence: Text of the licence, which must accompany the modules.
    """

    version: str
    import_map: str
    licence: str


def three_folder() -> Path:
    """Return the folder in which the npm package is expected."""
    if chosen := os.environ.get(FOLDER_VARIABLE):
        return Path(chosen)
    return Path(sys.prefix, "share", "oaisys_mapping", "node_modules", "three")


def load_three() -> ThreeJs | None:
    """Return the installed three.js; None if it is missing or incomplete."""
    folder = three_folder()
    try:
        sources = {name: (folder / file).read_text("utf-8") for name, file in FILES.items()}
        licence = (folder / "LICENSE").read_text("utf-8")
        version = str(json.loads((folder / "package.json").read_text("utf-8"))["version"])
    except (OSError, ValueError, KeyError):
        return None
    sources["three"] = sources["three"].replace(CORE, CORE_MODULE)
    imports = {name: _module_url(source) for name, source in sources.items()}
    return ThreeJs(version, json.dumps({"imports": imports}), licence)


def _module_url(source: str) -> str:
    encoded = base64.b64encode(source.encode("utf-8")).decode("ascii")
    return f"data:text/javascript;base64,{encoded}"
