"""Valid small worlds drawn from the whole configuration, each from a seed.

Unlike `config_strategies`, these are for rendering: every kind of ground, layer, sky, light,
object, camera and effect takes part, in sizes that render within seconds.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.config.sections.layers import LookConfig
from oaisys_core.config.sections.render import RenderConfig
from oaisys_core.procedural.scatter.rocks import ROCK_KINDS
from oaisys_core.procedural.scatter.shapes import SHAPES
from oaisys_core.procedural.terrain.presets import PRESETS
from oaisys_core.procedural.textures.library import TEXTURES

Json = dict[str, Any]
Image = NDArray[Any]

VEHICLES = ("rover", "lander")
GROWN = sorted(SHAPES - ROCK_KINDS - set(VEHICLES))
FOLDERS, HEIGHTS_PX, MAP_PX = 4, 49, 64
MODALITIES = ("rgb", "depth", "semantic_0", "instance", "albedo")
"""What is always rendered, because worlds are judged by it."""
MORE_MODALITIES = ("range", "normal", "flow", "semantic_1")


def choices(model: type, key: str) -> tuple[Any, ...]:
    """Return the values of a key that is one of a few words, or null, which is not among them."""
    annotation = model.model_fields[key].annotation  # type: ignore[attr-defined]
    words, *_ = *(each for each in get_args(annotation) if get_args(each)), annotation
    return get_args(words)


def make_files(folder: Path) -> None:
    """Write the textures, heights, skies and images that drawn worlds name."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(34)
    for number in range(FOLDERS):
        maps = folder / "pool" / f"photo_{number}"
        maps.mkdir(parents=True, exist_ok=True)
        height = smooth_noise(rng, MAP_PX, 1.5)
        color = np.clip(rng.uniform(60, 190, 3) + 60 * (height[..., None] - 0.5), 0, 255)
        dy, dx = np.gradient(height * 8)
        normal = np.dstack((np.ones_like(dx), dy, -dx)) / np.sqrt(1 + dx**2 + dy**2)[..., None]
        for name, image in (
            ("diff", color),
            ("disp", 255 * height),
            ("nor_gl", 127.5 * (normal + 1)),
            ("rough", 180 + 60 * height),
        ):
            write(maps / f"photo_{number}_{name}.png", image.astype(np.uint8))
    write(folder / "labels.png", np.repeat(np.eye(8, dtype=np.uint8) * 255, 8, axis=1))
    hills = smooth_noise(rng, HEIGHTS_PX, 8.0)
    write(folder / "heights.png", (hills * 65535).astype(np.uint16))
    write(folder / "density.png", (smooth_noise(rng, 32, 4.0) * 255).astype(np.uint8))
    write_mesh(folder / "ground.ply", hills * 12.0, 48.0)
    sky = np.full((32, 64, 3), 0.8, np.float32)
    sky[16:] = 0.15
    sky[6:8, 20:22] = 60.0
    write(folder / "sky.hdr", sky)
    poses = "sample_id,x_m,y_m,z_m,qx,qy,qz,qw\n0,0,0,9,0,0.38268343,0,0.92387953\n"
    (folder / "poses.csv").write_text(poses, encoding="utf-8")


def smooth_noise(rng: np.random.Generator, size: int, blur: float) -> Image:
    """Return a (size, size) image from 0 to 1."""
    image = cv2.GaussianBlur(rng.uniform(0, 1, (size, size)), (0, 0), blur)
    return np.asarray((image - image.min()) / np.ptp(image))


def write(path: Path, image: Image) -> None:
    """Write an image."""
    assert cv2.imwrite(str(path), image), path


def write_mesh(path: Path, heights_m: Image, extent_m: float) -> None:
    """Write heights as a mesh of triangles."""
    size = len(heights_m)
    axis = np.linspace(-extent_m / 2, extent_m / 2, size)
    x, y = np.meshgrid(axis, axis)
    first = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack((first, first + 1, first + size + 1), axis=-1),
            np.stack((first, first + size + 1, first + size), axis=-1),
        ]
    )
    lines = [
        "ply\nformat ascii 1.0",
        f"element vertex {size * size}",
        "property float x\nproperty float y\nproperty float z",
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header",
        *(
            f"{a:.4f} {b:.4f} {c:.4f}"
            for a, b, c in zip(x.flat, y.flat, heights_m.flat, strict=True)
        ),
        *(f"3 {a} {b} {c}" for a, b, c in faces),
    ]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


class Draw:
    """A generator with words for what worlds need."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.rng = np.random.default_rng([34, seed])
        self.folder = folder.resolve()

    def chance(self, share: float) -> bool:
        """Return True in a share of all cases."""
        return bool(self.rng.random() < share)

    def one(self, values: Any) -> Any:
        """Return one of several values."""
        values = list(values)
        return values[int(self.rng.integers(len(values)))]

    def number(self, low: float, high: float) -> float:
        """Return a number between two."""
        return round(float(self.rng.uniform(low, high)), 4)

    def log(self, low: float, high: float) -> float:
        """Return a random number between two, with a uniformly distributed logarithm."""
        return float(f"{np.exp(self.rng.uniform(np.log(low), np.log(high))):.4g}")

    def whole(self, low: int, high: int) -> int:
        """Return a whole number from one to another."""
        return int(self.rng.integers(low, high, endpoint=True))

    def color(self, low: float = 0.0, high: float = 1.0) -> list[float]:
        """Return a colour."""
        return [self.number(low, high) for _ in range(3)]

    def some(self, **keys: Any) -> Json:
        """Return about half of some keys."""
        return {key: value for key, value in keys.items() if self.chance(0.5)}

    def file(self, name: str) -> str:
        """Return the path of a file that `make_files` wrote."""
        return str(self.folder / name)


def drawn_world(seed: int, folder: Path, backend: str = "blender") -> Json:
    """Return the configuration of a world as plain data, the same for the same seed.

    Args:
        seed: Of all draws.
        folder: Where `make_files` has written.
        backend: The renderer.
    """
    draw = Draw(seed, folder)
    body = draw.one(("earth", "earth", "earth", "mars", "moon"))
    stage, materials = drawn_stage(draw, body), drawn_materials(draw)
    if "mesh" in stage:
        materials.pop("displacement", None)  # needs heights on a grid
    labels = [layer["label"] for layer in materials["layers"]]
    environment = drawn_environment(draw, body)
    is_bright = environment["sun_elevation_deg"] >= 20 and environment["sky"]["model"] != "none"
    return {
        "seed": draw.whole(0, 2**31),
        "backend": backend,
        "stage": stage,
        "materials": materials,
        "assets": drawn_assets(draw, labels),
        "environment": environment,
        "sensors": drawn_sensors(draw),
        "render": drawn_render(draw, is_bright),
    }


def drawn_stage(draw: Draw, body: str) -> Json:
    """Return ground of any kind."""
    stage: Json = {"body": body, **draw.some(surroundings=draw.one(("land", "plain")))}
    kind = draw.one(("preset",) * 8 + ("dem", "mesh"))
    if kind == "dem":
        stage["dem"] = {"file": draw.file("heights.png"), "spacing_m": 1.0}
        stage["dem"]["scale"] = draw.log(0.02 / 257, 0.2 / 257)
    elif kind == "mesh":
        stage["mesh"] = {"file": draw.file("ground.ply"), "scale": draw.number(0.7, 1.2)}
    else:
        stage["preset"] = draw.one(sorted(PRESETS))
        stage["extent_m"] = draw.number(20, 60)
        stage["resolution_px"] = draw.one((97, 129, 193))
        stage |= draw.some(relief_m=draw.log(0.5, 25), roughness=draw.number(0, 2))
    if kind == "preset" and draw.chance(0.15):
        stage["detail"] = {
            "radius_m": 2.0,
            "spacing_m": 0.08,
            "amplitude_m": draw.number(0, 0.05),
            "textures": draw.one((0.0, 1.0, 2.0)),
        }
    if draw.chance(0.25):
        stage["water"] = {
            "level_share": draw.number(0.05, 0.6),
            "semantic_id": 300,
            **draw.some(
                clarity_m=draw.log(0.05, 5),
                waves=draw.number(0, 1),
                wet_bank_m=draw.one((0.0, 0.1, 1.0)),
                color_srgb=draw.color(0.1, 0.5),
            ),
        }
    return stage


def drawn_layer(draw: Draw, index: int) -> Json:
    """Return a layer of the ground."""
    layer: Json = {"label": f"layer_{index}", "semantic_id": index + 21}
    if draw.chance(0.3):
        layer["folder"] = draw.file(f"pool/photo_{draw.whole(0, FOLDERS - 1)}")
    else:
        layer["texture"] = draw.one(sorted(TEXTURES))
    layer["anti_tiling"] = draw.one(choices(LookConfig, "anti_tiling"))
    layer |= draw.some(
        tile_m=draw.log(0.5, 8),
        cell_tiles=draw.log(0.5, 3),
        rotation_deg=draw.number(0, 180),
        normal_strength=draw.number(0, 3),
        share=draw.log(0.2, 3),
        exposure=draw.number(-1, 1),
    )
    if draw.chance(0.3):
        layer["color"] = draw.some(
            hue_deg=draw.number(-40, 40), saturation=draw.log(0.5, 2), value=draw.log(0.6, 1.5)
        )
        layer["color"] |= draw.some(curves={"combined": [[0.5, draw.number(0.35, 0.65)]]})
    if draw.chance(0.2):
        layer["displacement_m"] = draw.log(0.01, 0.3)
    if draw.chance(0.3):
        layer["when"] = draw.one(
            (
                {"slope_deg": [0, draw.number(10, 60)]},
                {"slope_deg": [draw.number(10, 50), 90]},
                {"height_share": [draw.number(0, 0.5), 1.0], "soft_m": draw.number(0, 1)},
            )
        )
    if draw.chance(0.15):
        mapping = {"255": {"label": f"mark_{index}", "semantic_id": 200 + index}}
        layer["labels_from"] = {"image": draw.file("labels.png"), "mapping": mapping}
    if draw.chance(0.2):
        layer["levels"] = [{"label": "ground", "semantic_id": 250}]
    return layer


def drawn_materials(draw: Draw) -> Json:
    """Return from 1 to 16 layers, perhaps more from pools."""
    count = draw.one((1, 2, 2, 3, 3, 4, 4, 5, 6, 8, 12, 16))
    materials: Json = {
        "layers": [drawn_layer(draw, index) for index in range(count)],
        "texture_size_px": 128,
        "mask": {
            "size_px": 128,
            "scale_m": draw.log(1.5, 20),
            **draw.some(
                sharpness=draw.number(0, 1),
                relief=draw.number(0, 1),
                method=draw.one(("patches", "noise")),
            ),
        },
        **draw.some(
            projection=draw.one(("auto", "top", "sides")),
            label_borders=draw.one(("hard", "soft")),
            displacement=draw.one(("bump", "geometry")),
            macro_variation=draw.number(0, 1),
            variation={"brightness": draw.number(0, 0.8), "tint": draw.number(0, 0.3)},
        ),
    }
    if draw.chance(0.15):
        look = {"tile_m": draw.log(0.5, 6), "anti_tiling": draw.one(("none", "voronoi"))}
        pool = {"folder": draw.file("pool"), "look": look, "count": [1, draw.whole(1, 3)]}
        materials["pools"] = [pool]
    return materials


def drawn_density(draw: Draw, labels: list[str]) -> Json:
    """Return a density of any kind."""
    kind = draw.one(("noise", "voronoi", "slope", "height", "moisture", "layer", "image"))
    more: Json = {}
    if kind == "layer":
        more["label"] = draw.one((labels[0], labels))
    if kind == "image":
        more["file"] = draw.file("density.png")
    return {"kind": kind, **more, **draw.some(least=draw.number(0, 0.5))}


def drawn_assets(draw: Draw, labels: list[str]) -> Json:
    """Return rocks, plants, vehicles and calibration bodies."""
    rocks = [
        {"kind": draw.one(sorted(ROCK_KINDS)), "count": [5, 40], "variants": 2}
        | draw.some(size_m=[0.1, draw.log(0.2, 2)])
        for _ in range(draw.one((0, 0, 1, 2)))
    ]
    groups = []
    for index in range(draw.one((0, 0, 1, 1, 2))):
        group = {
            "name": f"group_{index}",
            "shape": draw.one(GROWN if draw.chance(0.6) else sorted(ROCK_KINDS)),
            "variants": 1,
            "label": f"group_{index}",
            "semantic_id": 310 + index,
            "count": [4, draw.one((10, 60))],
            "size_m": [0.2, draw.log(0.3, 4)],
            "density": [drawn_density(draw, labels)],
        }
        groups.append(group | draw.some(texture=draw.one(sorted(TEXTURES))))
    assets: Json = {"rocks": rocks, "groups": groups}
    assets |= draw.some(rock_texture=draw.one(sorted(TEXTURES)), rock_tile_m=draw.log(0.5, 4))
    if draw.chance(0.2):
        place = {"position_m": [draw.number(-4, 4), draw.number(-4, 4), 0.0], "on_ground": True}
        vehicle = {"name": "vehicle", "shape": draw.one(VEHICLES), **place}
        assets["objects"] = [vehicle | {"label": "vehicle", "semantic_id": 320}]
    if draw.chance(0.2):
        way = {"waypoints_m": [[-6, -3], [draw.number(-2, 6), draw.number(-6, 6)]]}
        mover = {"name": "driver", "shape": "rover", "trajectory": way}
        assets["movers"] = [mover | {"label": "driver", "semantic_id": 321}]
    if draw.chance(0.15):
        position = [draw.number(-5, 5), draw.number(-5, 5), draw.number(0, 3)]
        target = {"shape": draw.one(("sphere", "box")), "size_m": [1.2] * 3, "position_m": position}
        assets["primitives"] = [target | {"color_srgb": draw.color(0.3, 0.9)}]
    return assets


def drawn_environment(draw: Draw, body: str) -> Json:
    """Return sky, sun, air and lamps."""
    model = {"earth": "atmosphere", "mars": "plain", "moon": "none"}[body]
    sky = {"model": draw.one((model, model, model, "atmosphere", "plain", "none"))}
    environment: Json = {
        "sun_elevation_deg": draw.one((80.0, 60.0, 60.0, 38.0, 38.0, 20.0, 10.0, 6.0, 1.0, -20.0)),
        "sun_azimuth_deg": draw.number(0, 360),
        "sky": sky,
        **draw.some(ground_beyond=draw.chance(0.8), sky_semantic_id=400),
    }
    if sky["model"] == "plain":
        sky |= draw.some(zenith_srgb=draw.color(0.3, 0.8), horizon_srgb=draw.color(0.4, 0.9))
        environment |= draw.some(optical_depth=draw.log(0.1, 2))
    if sky["model"] == "atmosphere":
        environment |= draw.some(air=draw.log(0.3, 3), dust=draw.log(0.3, 5), ozone=1.5)
    environment |= draw.some(sun_angular_diameter_deg=draw.log(0.1, 5), sun_disc=draw.number(0, 1))
    if draw.chance(0.25):
        haze = draw.some(visibility_m=draw.log(50, 3e4), angstrom_exponent=draw.number(0, 4))
        environment["haze"] = haze | draw.some(color_srgb=draw.color(0.5, 1.0))
    if draw.chance(0.25) and sky["model"] != "none":
        environment["clouds"] = draw.some(
            cover=draw.number(0, 1),
            base_m=draw.log(300, 3000),
            kind=draw.one(("cumulus", "stratocumulus")),
            thickness_m=draw.log(20, 2000),
        )
    if draw.chance(0.12):
        environment["hdri"] = {"images": [{"file": draw.file("sky.hdr")}], "rotation_deg": [0, 360]}
        environment["hdri"] |= draw.some(keep_sun=True)
    is_night = environment["sun_elevation_deg"] < 0 and "hdri" not in environment
    lamps = {f"lamp_{index}": drawn_lamp(draw) for index in range(draw.one((0, 0, 0, 1, 2, 4)))}
    if is_night or (sky["model"] == "none" and draw.chance(0.3)):
        lamps["head"] = {"frame": "base_link", "position_m": [0.1, 0.0, 0.2], "strength_w": 8000}
    if lamps:
        environment["lamps"] = lamps
    return environment


def drawn_lamp(draw: Draw) -> Json:
    """Return a lamp that stands on the ground."""
    lamp: Json = {"kind": draw.one(("point", "spot", "area")), "on_ground": True}
    lamp["position_m"] = [draw.number(-8, 8), draw.number(-8, 8), draw.number(1, 6)]
    lamp |= {"strength_w": draw.log(20, 3000), "color_srgb": draw.color(0.4, 1.0)}
    if lamp["kind"] == "spot":
        lamp |= draw.some(cone_deg=draw.number(10, 120), cone_softness=draw.number(0, 1))
    return lamp


def drawn_camera(draw: Draw, name: str) -> Json:
    """Return a camera of 64 by 48 pixels with a lens of any kind."""
    modalities = [*MODALITIES, *(each for each in MORE_MODALITIES if draw.chance(0.2))]
    camera: Json = {"name": name, "width_px": 64, "height_px": 48}
    camera["fx_px"] = camera["fy_px"] = draw.number(35, 110)
    kind = draw.one(("plain",) * 4 + ("fisheye", "distortion", "depth", "motion", "rolling"))
    if kind == "fisheye":
        camera["fx_px"] = camera["fy_px"] = draw.number(20, 60)
        camera["fisheye"] = draw.some(k1=draw.number(-0.02, 0.05))
    elif kind == "distortion":
        camera["fx_px"] = camera["fy_px"] = draw.number(60, 110)
        camera["distortion"] = {"k1": draw.number(-0.2, 0.2), "p1": draw.number(-0.01, 0.01)}
    elif kind == "depth":
        # Of lenses that exist: in air none is faster than f/0.5, and blur far wider than a pixel
        # has grain at any quality, because each of its samples goes through one point of the lens.
        camera["lens"] = {"focus_distance_m": draw.log(1, 15), "f_number": draw.log(1, 16)}
        camera["lens"] |= draw.some(blades=draw.whole(3, 8), ratio=draw.log(0.5, 2))
    elif kind == "motion":
        camera["shutter_share"] = draw.number(0.1, 0.8)
    elif kind == "rolling":
        camera |= {"readout_s": draw.number(0, 0.05), "exposure_s": draw.number(0, 0.02)}
        modalities = [each for each in modalities if each != "flow"]
    return {**camera, "modalities": modalities}


def drawn_sensors(draw: Draw) -> Json:
    """Return cameras that look at the ground, above it."""
    sensors: Json = {"pose_policy": "clamp", "min_clearance_m": 0.6}
    sensors["cameras"] = [
        drawn_camera(draw, f"camera_{i}") for i in range(draw.one((1, 1, 1, 1, 1, 2)))
    ]
    if draw.chance(0.05):
        stereo = {"name": "pair", "width_px": 64, "height_px": 48, "fx_px": 60.0, "fy_px": 60.0}
        sensors["stereo"] = [{**stereo, "modalities": [*MODALITIES, "disparity"]}]
    sensors["motion"] = draw.one(
        (
            {
                "kind": "hover",
                "height_above_ground_m": draw.log(1.2, 15),
                "look": "forward",
                "pitch_deg": draw.number(5, 50),
                "x_m": [-7, 7],
                "y_m": [-7, 7],
            },
            {"kind": "hover", "height_above_ground_m": draw.log(1.5, 20), "x_m": [-6, 6]},
            {
                "kind": "around_target",
                "target_above_ground": True,
                "distance_m": draw.log(3, 14),
                "elevation_deg": draw.number(15, 80),
            },
            {
                "kind": "look_at",
                "position_m": [[-8, 8], [-8, 8], [16, 22]],
                "target_above_ground_m": 0.0,
            },
            {"kind": "grid", "columns": 2, "rows": 2, "altitude_m": draw.log(3, 15)},
            {"kind": "csv", "path": draw.file("poses.csv"), "height_above_ground_m": [3, 6]}
            | {"at_end": "stay"},
        )
    )
    return sensors


def drawn_render(draw: Draw, is_bright: bool) -> Json:
    """Return a quality and effects on the picture; a fixed exposure in bright worlds only."""
    render: Json = {"quality": draw.one(("preview", "standard", "standard", "high"))}
    render |= draw.some(
        view_transform=draw.one(choices(RenderConfig, "view_transform")),
        white_balance=draw.one(choices(RenderConfig, "white_balance")),
    )
    if is_bright and draw.chance(0.2):
        render["exposure_ev"] = draw.number(-1, 2)
    elif draw.chance(0.2):
        render["auto_exposure"] = {"target": draw.number(0.15, 0.4)}
    if draw.chance(0.3):
        effects = draw.some(
            chromatic_aberration=draw.number(-0.01, 0.01),
            bloom={"radius_px": draw.log(1, 8)},
            vignetting=draw.number(0, 0.8),
        )
        render["effects"] = effects
    if draw.chance(0.15):
        render["camera_look"] = draw.one(("machine_vision", "mars_mastcam_like"))
    return render
