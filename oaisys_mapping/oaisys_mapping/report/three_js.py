"""three.js as a page takes it in: its modules and its licence, from where set-up put them.

Nothing of it is part of this repository: `make setup` has npm install it, and a page that is made
where it is missing does without.
"""

from __future__ import annotations

import base64
import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path

FOLDER_VARIABLE = "OAISYS_THREE"
"""Names another folder of the npm package ``three``, for those who do not use `make setup`."""

CORE, CORE_MODULE = "./three.core.min.js", "three/core"
"""How one half of three.js asks for the other, and what it asks for in a page without files."""

FILES = {
    "three": "build/three.module.min.js",
    CORE_MODULE: "build/three.core.min.js",
    "three/OrbitControls": "examples/jsm/controls/OrbitControls.js",
}
"""Files by the names under which modules import them."""


@dataclass(frozen=True)
class ThreeJs:
    """What is needed of three.js.

    Attributes:
        version: Of the npm package.
        import_map: JSON for a ``script`` of type ``importmap``: the modules as ``data:`` URLs.
        licence: Its text, which must go where the modules go.
    """

    version: str
    import_map: str
    licence: str


def three_folder() -> Path:
    """Return the folder where the npm package is looked for."""
    if chosen := os.environ.get(FOLDER_VARIABLE):
        return Path(chosen)
    return Path(sys.prefix, "share", "oaisys_mapping", "node_modules", "three")


def load_three() -> ThreeJs | None:
    """Return the installed three.js, or None where there is none that can be used."""
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
