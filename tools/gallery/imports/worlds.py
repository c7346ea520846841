"""The ten worlds: what was brought, the configuration that uses it, and what is looked at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from oaisys_core.files.calibrations import read_calibration
from oaisys_core.files.calibrations.reading import read_robot_file
from oaisys_core.importing.robots import robot_sections, sensors_section
from tools.gallery.imports.meshes import write_plant, write_rover
from tools.gallery.imports.obj_files import write_hut
from tools.gallery.imports.robots import write_camchain, write_urdf
from tools.gallery.imports.surroundings import (
    write_elevation,
    write_panorama,
    write_paving,
    write_survey,
)

TILE_PX = (480, 300)
Place = tuple[float, float]
Section = dict[str, Any]


@dataclass(frozen=True)
class Outlook:
    """Where a picture is taken from: places in metres, heights above the surface there."""

    eye_m: Place
    height_m: float
    target_m: Place
    rise_m: float = 0.0


@dataclass(frozen=True)
class ImportedWorld:
    """A world with something that was brought.

    Attributes:
        name: Its name.
        caption: What was brought.
        sections: Its configuration, without backend and quality.
        views: What is looked at; empty: the rig's own motion.
        samples: Number of samples of that motion.
        modalities: What is shown of each camera.
        columns: Images beside each other.
    """

    name: str
    caption: str
    sections: Section
    views: tuple[Outlook, ...] = ()
    samples: int = 1
    modalities: tuple[str, ...] = ("rgb",)
    columns: int = 1
    order: tuple[int, ...] = field(default=())


def make_worlds(folder: Path) -> list[ImportedWorld]:
    """Write the files of all worlds into a folder, and return the worlds."""
    folder.mkdir(parents=True, exist_ok=True)
    makers: tuple[Callable[[Path], ImportedWorld], ...] = (
        _rover, _leaves, _hut, _robot, _robots_camera, _rig, _survey, _paving, _panorama, _valley,
    )  # fmt: skip
    return [make(folder) for make in makers]


def _camera(fx_px: float, size_px: tuple[int, int] = TILE_PX, **more: Any) -> Section:
    width, height = size_px
    camera = {"width_px": width, "height_px": height, "fx_px": fx_px, "fy_px": fx_px}
    return {"cameras": [{**camera, "modalities": ["rgb"], **more}]}


def _world(stage: Section, sensors: Section, sun_deg: float = 38.0, **more: Any) -> Section:
    assets = {"rocks": [], **more.pop("assets", {})}
    sky = {"environment": {"sun_elevation_deg": sun_deg}}
    return {"seed": 3, "stage": stage, "assets": assets, "sensors": sensors} | sky | more


MOUNDS = {"preset": "mounds", "extent_m": 60.0, "resolution_px": 257}
PLANE = {"preset": "plane", "extent_m": 60.0, "resolution_px": 129}
TREES = (
    (-9.0, 4.0),
    (-10.5, 5.5),
    (1.0, -5.0),
    (2.5, -6.5),
    (10.0, -4.0),
    (-1.5, 6.0),
    (11.5, 6.5),
)
IDS = {"rover": 61, "plant": 62, "hut": 63}
ROCKS = [{"count": [160, 160], "size_m": [0.1, 0.7], "variants": 8}]


def _object(name: str, file: str, x: float, y: float, **more: Any) -> Section:
    place = {"name": name, "file": file, "position_m": [x, y, 0.0], "on_ground": True}
    label = name.rstrip("0123456789")
    return {"label": label, "semantic_id": IDS[label], **place, **more}


def _rover(folder: Path) -> ImportedWorld:
    write_rover(folder / "rover.glb")
    assets = {"objects": [_object("rover", "rover.glb", 0.0, 0.0)], "rocks": ROCKS}
    sections = _world(MOUNDS, _camera(520.0), assets=assets)
    caption = "rover.glb: glTF with five textured materials"
    return ImportedWorld("rover", caption, sections, (Outlook((2.4, -2.2), 1.2, (0.0, 0.0), 0.55),))


def _leaves(folder: Path) -> ImportedWorld:
    write_plant(folder / "plant.glb")
    places = ((0.0, 0.0, 1.0), (1.6, 1.1, 1.3), (-1.3, 1.6, 0.8), (0.6, 2.9, 1.6), (-2.4, 3.2, 1.4))
    plants = [
        _object(f"plant{number}", "plant.glb", x, y, scale=scale)
        for number, (x, y, scale) in enumerate(places)
    ]
    layers = [{"texture": "grass", "label": "grass", "semantic_id": 1}]
    sections = _world(
        MOUNDS, _camera(470.0), assets={"objects": plants}, materials={"layers": layers}
    )
    caption = "plant.glb: leaf cards, cut out by alpha in every image"
    return ImportedWorld(
        "leaves", caption, sections, (Outlook((0.5, -2.3), 1.0, (0.2, 0.6), 0.55),)
    )


def _hut(folder: Path) -> ImportedWorld:
    write_hut(folder)
    hut = _object("hut", "hut.obj", 0.0, 0.0, up_axis="y")
    sections = _world(MOUNDS, _camera(420.0), assets={"objects": [hut], "rocks": ROCKS})
    caption = "hut.obj, hut.mtl and three pictures, y up"
    return ImportedWorld("hut", caption, sections, (Outlook((3.6, -4.4), 1.7, (0.0, 0.0), 1.1),))


def _robot_sections(folder: Path) -> Section:
    """Return the sections of ``oaisys sensors import scout.urdf --out scout.yaml``."""
    file = write_urdf(folder, (240, 300))
    robot = read_robot_file(file)
    assert robot is not None
    return robot_sections(robot, file, folder / "scout.yaml")[0]


def _robot(folder: Path) -> ImportedWorld:
    mover = _robot_sections(folder)["assets"]["movers"][0]
    mover |= {"trajectory": {"waypoints_m": [[-1.0, -0.6], [4.0, 2.4]], "step_m": 1.0}}
    sections = _world(MOUNDS, _camera(500.0), assets={"movers": [mover], "rocks": ROCKS})
    caption = "scout.urdf: its visuals as one mover, joints at zero"
    return ImportedWorld("robot", caption, sections, (Outlook((2.2, -1.9), 1.2, (0.0, 0.0), 0.45),))


def _robots_camera(folder: Path) -> ImportedWorld:
    sensors = _robot_sections(folder)["sensors"]
    rover = _object("rover", "rover.glb", 2.9, 0.35, quat_xyzw=[0.0, 0.0, 0.5, 0.8660254037844386])
    assets = {"objects": [rover], "rocks": ROCKS}
    sections = _world(MOUNDS, {**sensors, "pose_policy": "clamp"}, assets=assets)
    caption = "scout.urdf: its mast camera, colour and depth"
    view = Outlook((0.0, 0.0), 0.3, (4.0, 0.3), 0.2)
    return ImportedWorld(
        "mast_camera", caption, sections, (view,), modalities=("rgb", "depth"), columns=2
    )


def _rig(folder: Path) -> ImportedWorld:
    write_camchain(folder / "camchain.yaml")
    sensors = sensors_section(read_calibration(folder / "camchain.yaml"))
    for camera in sensors["cameras"]:
        camera["modalities"] = ["rgb"]
    hut, rover = (
        _object("hut", "hut.obj", 4.5, 1.4, up_axis="y"),
        _object(
            "rover",
            "rover.glb",
            2.6,
            -0.7,
            quat_xyzw=[0.0, 0.0, 0.9238795325112867, 0.38268343236508984],
        ),
    )
    sections = _world(MOUNDS, sensors, assets={"objects": [hut, rover], "rocks": ROCKS})
    caption = "camchain.yaml of Kalibr: radtan and equidistant"
    view = Outlook((0.0, 0.0), 1.3, (4.0, 0.0), 0.6)
    return ImportedWorld("rig", caption, sections, (view,), columns=2)


def _survey(folder: Path) -> ImportedWorld:
    count = write_survey(folder / "survey.txt")
    sensors = _camera(270.0, (TILE_PX[0] // 4, TILE_PX[1] // 3))
    sensors["motion"] = {"kind": "csv", "path": "survey.txt"}
    objects = [
        _object("hut", "hut.obj", -4.6, 1.2, up_axis="y"),
        _object("rover", "rover.glb", 6.2, 4.1, scale=1.5),
        *(_object(f"plant{n}", "plant.glb", *at, scale=2.0) for n, at in enumerate(TREES)),
    ]
    sections = _world(MOUNDS, sensors, 28.0, assets={"rocks": ROCKS, "objects": objects})
    caption = "survey.txt: a plan of twelve views straight down, TUM"
    # Every second row of the plan is flown back.
    order = (0, 1, 2, 3, 7, 6, 5, 4, 8, 9, 10, 11)
    return ImportedWorld("survey", caption, sections, samples=count, columns=4, order=order)


def _paving(folder: Path) -> ImportedWorld:
    write_paving(folder / "PavingStones001_1K-PNG")
    layer = {"folder": "PavingStones001_1K-PNG", "label": "paving", "semantic_id": 1}
    layers = [layer | {"tile_m": 1.6, "displacement_m": 0.03}]
    sections = _world(PLANE, _camera(430.0), 24.0, materials={"layers": layers})
    caption = "PavingStones001_1K-PNG/: maps of ambientCG, DirectX"
    return ImportedWorld("paving", caption, sections, (Outlook((0.0, 0.0), 1.1, (2.6, 0.9), 0.0),))


def _panorama(folder: Path) -> ImportedWorld:
    write_panorama(folder / "evening.hdr")
    sections = _world(
        MOUNDS,
        _camera(300.0),
        assets={"rocks": ROCKS, "objects": [_object("hut", "hut.obj", 8.0, 2.2, up_axis="y")]},
        environment={"hdri": {"images": [{"file": "evening.hdr"}], "keep_sun": False}},
    )
    caption = "evening.hdr: a panorama as sky and light"
    return ImportedWorld(
        "panorama", caption, sections, (Outlook((0.0, 0.0), 1.7, (8.0, 2.6), 3.0),)
    )


def _valley(folder: Path) -> ImportedWorld:
    write_elevation(folder / "valley_utm32.tif")
    layers = [
        {"texture": "grass", "label": "grass", "semantic_id": 1, "exposure": -1.0},
        {"texture": "rock", "label": "rock", "semantic_id": 2, "exposure": 1.0},
    ]
    stage = {"dem": {"file": "valley_utm32.tif"}}
    materials = {"layers": layers, "mask": {"relief": 1.0}}
    sections = _world(stage, _camera(270.0), 42.0, materials=materials)
    caption = "valley_utm32.tif: an elevation model, EPSG:32632"
    view = Outlook((60.0, -1850.0), 420.0, (0.0, 200.0), 0.0)
    return ImportedWorld("valley", caption, sections, (view,))
