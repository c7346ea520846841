"""``oaisys place``: where an elevation model lies on its body."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone
from math import degrees, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from oaisys_core.errors import InvalidInputError

if TYPE_CHECKING:
    from pyproj import CRS

    from oaisys_core.config.sections.stage import DemConfig
    from oaisys_core.procedural.environment.ephemeris import Target
    from oaisys_core.types import Georeference

place_app = typer.Typer(
    help="Find places of elevation models on their body.",
    no_args_is_help=True,
    add_completion=False,
)


@place_app.callback()
def _place() -> None:
    """Find places of elevation models on their body."""


@place_app.command("info")
def info(
    file: Annotated[
        Path, typer.Argument(help="Elevation model, or a configuration (.yaml) with stage.dem.")
    ],
    to_map: Annotated[
        list[str] | None,
        typer.Option(help="LON,LAT[,ELEVATION] to show in `map`. Can be repeated."),
    ] = None,
    from_map: Annotated[
        list[str] | None,
        typer.Option(help="X,Y[,Z] in `map` to show as a place. Can be repeated."),
    ] = None,
    at: Annotated[
        datetime | None,
        typer.Option(
            help="UTC time at which to show sun and Earth over the origin of `map`.",
            formats=["%Y-%m-%dT%H:%M:%SZ", "%Y-%m-%dT%H:%M:%S", "%Y-%m-%d"],
        ),
    ] = None,
) -> None:
    """Print where FILE lies: reference system, origin of `map`, true north, corners, the sun."""
    from oaisys_core.geometry import places
    from oaisys_core.procedural.terrain.dem import import_dem

    imported = import_dem(_dem(file))
    place = imported.georeference
    if place is None:
        expected = "an elevation model with a reference system, and pixels of its own size"
        raise InvalidInputError("file", str(file), expected)
    system = places.system_of(place.wkt)
    x0, y0, x1, y1 = imported.ground.extent_m
    ellipsoid = system.get_geod()
    radius_m = 0.0 if ellipsoid is None else ellipsoid.a
    _say(f"reference system  {_system(system)}")
    _say(f"body              {_body(system)}, equatorial radius {radius_m:.0f} m")
    _say(f"extent in map     x {x0:.3f} to {x1:.3f} m, y {y0:.3f} to {y1:.3f} m")
    _say(f"distance of heights in the file  {imported.posting_m:.4g} m")
    north_deg = places.north_deg(place)
    _say(f"+y points to      {north_deg:.4f}° from true north, clockwise")
    origin = places.lon_lat_height(place, (0.0, 0.0, 0.0))[0]
    _say(f"origin of map     {_shown(origin)}")
    corners = {
        "south-west": (x0, y0),
        "south-east": (x1, y0),
        "north-west": (x0, y1),
        "north-east": (x1, y1),
    }
    for name, corner in corners.items():  # no point of the ground: map's plane z = 0 is there
        _say(f"{name:<17} {_lon_lat(places.lon_lat_height(place, (*corner, 0.0))[0])}")
    for text in from_map or ():
        point_m = _numbers(text, "--from-map", "X,Y or X,Y,Z")
        _say(f"map {text}  is  {_shown(places.places_of(place, point_m)[0])}")
    for text in to_map or ():
        found = places.points_in_map(place, _numbers(text, "--to-map", "LON,LAT[,ELEVATION]"))[0]
        _say(f"place {text}  is  {', '.join(f'{each:.4f}' for each in found)} m in map")
    if at is not None:
        _say_light(place, imported.body_radius_m, at.replace(tzinfo=timezone.utc))  # noqa: UP017


def _say_light(place: Georeference, body_radius_m: float | None, when: datetime) -> None:
    """Print where the sun, and from other bodies Earth, stands over the origin of ``map``."""
    from oaisys_core.config.sections.stage import body_name
    from oaisys_core.config.sections.sun import SunFromTimeConfig
    from oaisys_core.procedural.environment.sun_in_map import map_axes, sight_over

    body = body_radius_m or 0.0
    axes = map_axes(SunFromTimeConfig(date_time=when), place, body)
    targets: tuple[Target, ...] = ("sun",) if body_name(body) == "earth" else ("sun", "earth")
    for target in targets:
        seen = sight_over(axes, body, target, when)
        _say(
            f"{target:<17} elevation {degrees(seen.elevation_rad):.4f}°, azimuth in map"
            f" {degrees(seen.azimuth_rad):.4f}° from +x towards +y, distance"
            f" {seen.distance_au:.8f} au, diameter {degrees(seen.angular_diameter_rad):.4f}°"
        )


def _dem(file: Path) -> DemConfig:
    from oaisys_core.config import load_config
    from oaisys_core.config.sections.stage import DemConfig

    if file.suffix.lower() not in (".yaml", ".yml"):
        if not file.is_file():
            raise InvalidInputError("file", str(file), "an existing file, no device and no pipe")
        return DemConfig(file=file)
    dem = load_config(file).stage.dem
    if dem is None:
        raise InvalidInputError("file", str(file), "a configuration with stage.dem")
    return dem


def _numbers(text: str, option: str, expected: str) -> Sequence[float]:
    try:
        values = [float(each) for each in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (2, 3) or not all(map(isfinite, values)):
        raise InvalidInputError(option, text, expected)
    return [*values, 0.0][:3]


def _system(system: CRS) -> str:
    """Return a reference system's name; the projection of a warped file has none."""
    operation = system.coordinate_operation
    if operation is None or system.name.lower() not in ("undefined", "unknown"):
        return str(system.name)
    return f"{operation.method_name} around the middle of the file"


def _body(system: CRS) -> str:
    name: str = system.ellipsoid.name if system.ellipsoid is not None else "unknown"
    return name


def _shown(place: Sequence[float]) -> str:
    return f"{_lon_lat(place)}, elevation {place[2]:.3f} m"


def _lon_lat(place: Sequence[float]) -> str:
    return f"longitude {place[0]:.9f}°, latitude {place[1]:.9f}°"


def _say(text: str) -> None:
    typer.echo(text)
