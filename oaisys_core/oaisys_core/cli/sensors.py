"""``oaisys sensors``: configurations of sensors from files of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from oaisys_core.cli.standard_output import write_or_print

if TYPE_CHECKING:
    from oaisys_core.files.calibrations import Calibration

sensors_app = typer.Typer(
    help="Configure sensors from files of others.", no_args_is_help=True, add_completion=False
)


@sensors_app.callback()
def _sensors() -> None:
    """Configure sensors from files of others."""


@sensors_app.command("import")
def import_(
    file: Annotated[
        Path,
        typer.Argument(
            help="Calibration: ROS's camera_info, Kalibr's camchain or imu, OpenCV's FileStorage,"
            " COLMAP's cameras.txt or .bin, nerfstudio's transforms.json."
        ),
    ],
    out: Annotated[Path | None, typer.Option(help="YAML file to write; default: print it.")] = None,
) -> None:
    """Print the section `sensors` of a configuration that has the sensors in FILE.

    What was assumed, and what of the file is not used, stands in comments.
    """
    from oaisys_core.config import config_from_mapping
    from oaisys_core.files.calibrations import read_calibration

    found = read_calibration(file)
    sensors = sensors_section(found)
    config_from_mapping({"sensors": sensors})
    write_or_print(_text(found, sensors, file.name), out)


def sensors_section(found: Calibration) -> dict[str, Any]:
    """Return the section `sensors` with the cameras and IMUs of a calibration.

    Raises:
        InvalidInputError: A camera has no image size.
    """
    from oaisys_core.errors import InvalidInputError

    for camera in found.cameras:
        if camera.size_px is None:
            expected = "a size; write it into the file, such as image_width and image_height"
            raise InvalidInputError(f"calibration.{camera.name}", "no image size", expected)
    sensors: dict[str, Any] = {}
    if found.cameras:
        sensors["cameras"] = [{"name": each.name, **each.config()} for each in found.cameras]
    if found.imus:
        sensors["imus"] = [dict(each) for each in found.imus]
    return sensors


def _text(found: Calibration, sensors: dict[str, Any], name: str) -> str:
    import yaml

    notes = [f"From {name} ({found.format}).", *(f"{note}." for note in found.notes)]
    body = yaml.safe_dump({"sensors": sensors}, sort_keys=False, default_flow_style=None)
    return "".join(f"# {note[0].upper()}{note[1:]}\n" for note in notes) + str(body)
