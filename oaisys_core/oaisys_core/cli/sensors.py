"""``oaisys sensors``: configurations of sensors from files of other programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from oaisys_core.cli.standard_output import write_or_print
from oaisys_core.files.folders import make_folder

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
            help="Robot: URDF or SDF. Calibration: ROS's camera_info, Kalibr's camchain or imu,"
            " EuRoC's sensor.yaml, OpenCV's FileStorage, COLMAP's cameras.txt or .bin, nerfstudio's"
            " transforms.json."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="YAML file to write; default: print it. Of a robot, its visuals are written beside"
            " it as NAME_visuals.glb, which is a mover of the configuration."
        ),
    ] = None,
    base: Annotated[
        str | None,
        typer.Option(
            help="Robot: the link that becomes base_link; default: the link of this name, else"
            " URDF's root, SDF's model."
        ),
    ] = None,
    camera: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LINK=FILE",
            help="Robot: a link, and the calibration of the camera that is there. Can be repeated.",
        ),
    ] = None,
    model: Annotated[
        str | None, typer.Option(help="SDF: the model; default: the only one.")
    ] = None,
    packages: Annotated[
        list[Path] | None,
        typer.Option(
            help="Robot: a folder with the packages and models of its meshes. Can be repeated.",
            exists=True,
            file_okay=False,
        ),
    ] = None,
) -> None:
    """Print the section `sensors` of a configuration that has the sensors in FILE.

    What was assumed, and what of the file is not used, stands in comments.
    """
    from oaisys_core.config import config_from_mapping
    from oaisys_core.errors import InvalidInputError
    from oaisys_core.files.calibrations.reading import read_robot_file
    from oaisys_core.importing.cameras_on_links import put_camera
    from oaisys_core.importing.robots import robot_sections

    if out is not None:
        make_folder(out.parent)
    notes: Sequence[str]
    robot = read_robot_file(file, base, model)
    if robot is not None:
        heading = f"From {file.name} ({robot.sensors.format})."
        names: set[str] = set()
        for link, calibration in map(_link_and_file, camera or ()):
            robot = put_camera(robot, link, calibration)
            name = robot.sensors.cameras[-1].name
            if name in names:
                expected = f"calibrations of cameras whose names differ, not {name} twice"
                raise InvalidInputError("camera", f"{link}={calibration}", expected)
            names.add(name)
        sections, notes = robot_sections(robot, file, out, packages or ())
    else:
        given = {"base": base, "model": model, "camera": camera, "packages": packages}
        heading, sections, notes = _calibration(file, given)
    folder = Path() if out is None else out.parent
    config_from_mapping(sections, base=folder)
    write_or_print(_text(heading, sections, notes), out)


def _link_and_file(text: str) -> tuple[str, Path]:
    """Return the two parts of `--camera LINK=FILE`."""
    from oaisys_core.errors import InvalidInputError

    link, _, file = text.partition("=")
    if not link or not file:
        expected = "LINK=FILE, such as camera_link=front.yaml"
        raise InvalidInputError("camera", text, expected)
    return link, Path(file)


def _calibration(
    file: Path, for_robots: Mapping[str, Any]
) -> tuple[str, dict[str, Any], Sequence[str]]:
    """Return the heading, the sections and the notes of a configuration with a file's sensors."""
    from oaisys_core.errors import InvalidInputError
    from oaisys_core.files.calibrations import read_calibration
    from oaisys_core.importing.robots import sensors_section

    for name, value in for_robots.items():
        if value:
            raise InvalidInputError(name, value, "none: it is for robots (URDF, SDF)")
    found = read_calibration(file)
    heading = f"From {file.name} ({found.format})."
    return heading, {"sensors": sensors_section(found)}, found.comments()


def _text(heading: str, sections: dict[str, Any], notes: Sequence[str]) -> str:
    import yaml

    from oaisys_core.files.yaml_documents import yaml_comments

    lines = [heading, *(f"{note}." for note in notes)]
    body = yaml.safe_dump(sections, sort_keys=False, default_flow_style=None)
    return yaml_comments(map(_sentence, lines)) + str(body)


def _sentence(text: str) -> str:
    """Return a text in one line, with a capital unless it begins with a name."""
    from oaisys_core.errors import one_line

    plain = one_line(text)
    is_name = plain.partition(" ")[0].endswith((":", ","))
    return plain if is_name else plain[0].upper() + plain[1:]
