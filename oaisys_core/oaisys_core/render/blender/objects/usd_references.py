"""What a USD file refers to: layers, textures, clips and volumes, found without reading them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import bpy

from oaisys_core.files.references import lies_within

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


def references_of(path: Path, folders: tuple[Path, ...]) -> Iterator[tuple[str, Path]]:
    """Yield what a USD file and its layers in some folders refer to, as written and as a path.

    Of a file in a package (``.usdz``) the path is that of the package. Nothing is yielded where
    Blender has no modules of USD.
    """
    try:
        bpy.utils.expose_bundled_modules()
        from pxr import Ar, Sdf, UsdUtils
    except (AttributeError, ImportError):
        return
    left, seen = [str(path)], {str(path)}
    while left:
        name = left.pop()
        layer = Sdf.Layer.FindOrOpen(name)
        if layer is None:
            continue
        for kind in UsdUtils.ExtractExternalReferences(name):
            for written in kind:
                found = layer.ComputeAbsolutePath(written)
                place = _place(path, Ar.SplitPackageRelativePathOuter(found)[0])
                yield written, place
                is_layer = Path(found.rstrip("]")).suffix.lower() in USD_SUFFIXES
                if is_layer and found not in seen and lies_within(place, folders):
                    seen.add(found)
                    left.append(found)


def check_unit(path: Path) -> None:
    """Raise if a USD file has a unit that is no length.

    Raises:
        ValueError: With the unit.
    """
    try:
        bpy.utils.expose_bundled_modules()
        from pxr import Sdf
    except (AttributeError, ImportError):
        return
    layer = Sdf.Layer.FindOrOpen(str(path))
    unit = 1.0 if layer is None else layer.pseudoRoot.GetInfo("metersPerUnit")
    if not 0 < unit < math.inf:
        raise ValueError(f"a metersPerUnit above 0, not {unit:g}")


def _place(path: Path, found: str) -> Path:
    """Return where USD looks for a file: names that are not beside it, in the current folder."""
    place = Path(found)
    here = Path.cwd() / place
    return here if here.exists() else path.parent / place
