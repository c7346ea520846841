"""The page of the names that a configuration may use, from the code that knows them."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from oaisys_core.cli.standard_output import write_or_print

EXTENT_M = 60.0
RESOLUTION_PX = 65

HEAD = """# Names

`make schema` writes this page from the code (`oaisys config names`). What is installed as an
[extension](../examples/extensions/README.md) has further names.

## Terrains

`stage.preset`. The height differences are those of one stage of 60 m, whose `relief_m` is left to
the preset (seed 0); most grow with `extent_m`.

| name | height difference | what it is | |
|---|---|---|---|
"""

TEXTURES = """
## Textures

`materials.layers[].texture`. A layer can have a `folder` of images instead, see below.

| name | tile | what it is | |
|---|---|---|---|
"""

ROCKS = """
## Rocks

`assets.rocks[].kind`. `size_m` is the length along the longest axis; the others are shares of it.

| name | middle axis | short axis | lies where | |
|---|---|---|---|---|
"""

SHAPES = """
## Plants and vehicles

`shape` of scattered objects and movers.

{plants}

| vehicle | what it is | |
|---|---|---|
"""

SKIES = """
## Skies

`environment.sky.model`, each as in an example. [Light](light.md) has the sun, haze and clouds.

| name | what it is | example | |
|---|---|---|---|
"""

SKY_MODELS = {
    "atmosphere": ("Earth's, on a clear day: sunlight that air, dust and ozone scatter.", "sky"),
    "none": ("Black, as on the Moon.", "moon"),
    "overcast": ("Thick clouds from horizon to horizon, without a sun.", "overcast"),
    "plain": ("Colours of your own for zenith and horizon, here those of Mars.", "mars"),
}
"""What each sky is, and which ``environment_*.yaml`` of the examples shows it."""

PLANT_COLUMNS = 3

FOLDERS = """
## Folders of textures

Which image of a folder is which map is read from the last of these words in its name. A hyphen
joins words that follow each other. Images are read from {suffixes}.

| map | words |
|---|---|
"""

PACKED = """
Channels of packed maps (a dash is not used):

| word | red | green | blue | alpha |
|---|---|---|---|---|
"""

POSES = """
## Columns of `poses.csv`

`oaisys render` writes them, and `--poses` reads them. `t_s`, the time in seconds, is read too.
`sample_id` is not needed.

| column | what it is |
|---|---|
"""

COLUMNS = {
    "sample_id": "number of the sample in its batch, from 1",
    "x_m": "position of the rig in `map`, metres east or along the stage's x",
    "y_m": "the same along y",
    "z_m": "the same, up",
    "qx": "unit quaternion that turns the rig's axes (x forward, y left, z up) into `map`: x",
    "qy": "its y",
    "qz": "its z",
    "qw": "its real part",
}

RECIPES = """
## Recipes

An overcast day, without a hard shadow. Between the shadows of
`environment.clouds`, the light is that of a clear day.

```yaml
environment: {sun_elevation_deg: 30, sky: {model: overcast}, haze: {visibility_m: 9000}}
```

One crater of a chosen depth. Its width is five times the depth (`relief_m`); its place is drawn
from the seed:

```yaml
stage: {preset: craters, extent_m: 60, relief_m: 4}
```

A crater at a chosen place: heights of your own, as in
[examples/04_own_world.py](../examples/04_own_world.py).
"""


def names(
    out: Annotated[Path | None, typer.Option(help="File to write; default: print it.")] = None,
) -> None:
    """Write the page that lists names: terrains, textures, rocks, shapes, maps, columns."""
    write_or_print(names_text(measure_relief_m()), out)


def measure_relief_m(presets: Iterable[str] | None = None) -> dict[str, float]:
    """Return the height differences of terrains with their default relief, metres.

    Args:
        presets: Names of presets; None for all.
    """
    import numpy as np

    from oaisys_core.procedural.terrain.presets import PRESETS, make_ground

    found = {}
    for name in sorted(PRESETS if presets is None else presets):
        ground = make_ground(name, EXTENT_M, RESOLUTION_PX, np.random.default_rng(0))
        found[name] = float(np.ptp(ground.elevation_m))
    return found


def names_text(relief_m: Mapping[str, float]) -> str:
    """Return the page in Markdown.

    Args:
        relief_m: See `measure_relief_m`.
    """
    from oaisys_core.files.poses.tables import POSE_NUMBERS
    from oaisys_core.procedural.scatter.rock_families import ROUNDED
    from oaisys_core.procedural.scatter.rocks import STYLES
    from oaisys_core.procedural.scatter.shapes import PLANTS
    from oaisys_core.procedural.scatter.vehicles import VEHICLES
    from oaisys_core.procedural.terrain.presets import PRESETS
    from oaisys_core.procedural.textures import map_names
    from oaisys_core.procedural.textures.library import RECIPES as SETS

    terrains = [
        (f"`{n}`", f"{relief_m[n]:.1f} m", _meaning(PRESETS[n]), _picture("terrains", n))
        for n in sorted(PRESETS)
    ]
    textures = [
        (f"`{n}`", f"{SETS[n].tile_m:g} m", _meaning(SETS[n].make), _picture("textures", n))
        for n in sorted(SETS)
    ]
    axes = {n: ["{:g} to {:g}".format(*axis) for axis in STYLES[n].axes] for n in STYLES}
    rocks = [
        (f"`{n}`", *axes[n], _place(n in ROUNDED), _picture("rocks", n)) for n in sorted(STYLES)
    ]
    vehicles = [
        (f"`{n}`", _vehicle(made), _picture("vehicles", n)) for n, made in sorted(VEHICLES.items())
    ]
    maps = [(kind, words) for kind, words in map_names.WORDS.items() if kind != map_names.PACKED]
    packed = [
        (word, *(each or "–" for each in (*channels, "", "", "")[:4]))
        for word, channels in map_names.CHANNELS.items()
    ]
    columns = [(f"`{n}`", COLUMNS[n]) for n in ("sample_id", *POSE_NUMBERS)]
    suffixes = ", ".join(f"`{each}`" for each in sorted(map_names.SUFFIXES))
    parts = [HEAD, _rows(terrains), TEXTURES, _rows(textures), ROCKS, _rows(rocks)]
    parts += [
        SHAPES.format(plants=_plant_table(sorted(PLANTS))),
        _rows(vehicles),
        SKIES,
        _rows(_sky(name, *said) for name, said in SKY_MODELS.items()),
        FOLDERS.format(suffixes=suffixes),
        _rows(maps),
    ]
    parts += [PACKED, _rows(packed), POSES, _rows(columns), RECIPES]
    return "".join(parts)


def _meaning(maker: Any) -> str:
    """Return the first paragraph of the docstring of whatever makes a thing."""
    return " ".join((inspect.getdoc(maker) or "").split("\n\n")[0].split()).replace("|", "\\|")


def _vehicle(maker: Any) -> str:
    """Return what a function says that it returns."""
    meaning = _meaning(maker).removeprefix("Return ")
    return meaning[:1].upper() + meaning[1:]


def _place(is_worn: bool) -> str:
    return "where water runs" if is_worn else "near scarps"


def _picture(group: str, name: str) -> str:
    """Return a picture that `make site-pictures` makes, for a page in ``docs/``."""
    return f"![{name}](pictures/{group}/{name}.webp)"


def _sky(name: str, meaning: str, example: str) -> tuple[str, ...]:
    file = f"environment_{example}.yaml"
    link = f"[{file}](../config/examples/{file})"
    return f"`{name}`", meaning, link, _picture("skies", name)


def _plant_table(names: Sequence[str]) -> str:
    """Return a table with a picture above each name."""
    cells = [f"{_picture('plants', name)}<br>`{name}`" for name in names]
    cells += [""] * (-len(cells) % PLANT_COLUMNS)
    head = f"| plants |{' |' * (PLANT_COLUMNS - 1)}\n|{'---|' * PLANT_COLUMNS}\n"
    rows = zip(*(cells[first::PLANT_COLUMNS] for first in range(PLANT_COLUMNS)), strict=True)
    return (head + _rows(rows)).rstrip()


def _rows(rows: Iterable[tuple[str, ...]]) -> str:
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)
