"""The environment module: what it draws, when, and what it refuses."""

from dataclasses import replace
from importlib.metadata import EntryPoint
from math import degrees, radians
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_worlds import SMALL_MATERIALS

from oaisys_core import extensions, randomness
from oaisys_core.color import LUMINANCE
from oaisys_core.config.loading import config_from_mapping
from oaisys_core.config.sections.environment import EnvironmentConfig
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.geometry import pose_looking_at
from oaisys_core.procedural.environment import effects
from oaisys_core.procedural.environment.light import level_irradiance_w_m2
from oaisys_core.procedural.terrain.surroundings.kinds import Surroundings
from oaisys_core.scene import Sky
from oaisys_core.scene.sky import gradient_radiance
from oaisys_core.simulation import Simulation
from oaisys_core.types import SEMANTIC_0, ModuleMetadata
from oaisys_core.world.module import World, require
from oaisys_core.world.modules import EnvironmentModule

SEED = 5
RED, GREEN, BLUE = (255, 0, 0), (0, 255, 0), (0, 0, 255)


def skies(section: dict[str, Any], samples: int = 0, seed: int = SEED) -> list[Sky]:
    """The sky of a batch, then those of its samples."""
    module = EnvironmentModule(EnvironmentConfig.model_validate(section))
    module.setup()
    world = World()
    module.step_batch(world, None, randomness.stream(seed, module.name))
    seen = [require(world.sky)]
    for sample_id in range(1, samples + 1):
        world.sample_id = sample_id
        module.step_sample(world, None, randomness.stream(seed, module.name, sample_id))
        seen.append(require(world.sky))
    return seen


class TestRanges:
    """Numbers that are drawn."""

    def test_the_default_sky_is_not_drawn(self) -> None:
        (sky,) = skies({})
        assert degrees(sky.sun_elevation_rad) == pytest.approx(38)
        assert (sky.sun_strength_w_m2, sky.air, sky.dust, sky.ozone) == (4, 1, 1, 1)

    def test_every_number_may_be_a_range_and_stays_in_it(self) -> None:
        ranges = {
            "sun_elevation_deg": (10.0, 20.0),
            "sun_azimuth_deg": (100.0, 200.0),
            "sun_strength_w_m2": (1.0, 2.0),
            "sun_angular_diameter_deg": (0.5, 0.6),
            "sun_disc": (0.1, 0.2),
            "sky_strength": (0.5, 0.6),
            "air": (0.2, 0.3),
            "dust": (3.0, 4.0),
            "ozone": (5.0, 6.0),
            "altitude_m": (1000.0, 2000.0),
        }
        drawn_skies = [skies(ranges, seed=seed)[0] for seed in range(40)]
        for name, (least, most) in ranges.items():
            angle = name.endswith("_deg")
            values = [getattr(s, name[:-3] + "rad" if angle else name) for s in drawn_skies]
            values = [degrees(v) if angle else v for v in values]
            assert least <= min(values) < least + 0.2 * (most - least), name
            assert most >= max(values) > most - 0.2 * (most - least), name

    def test_fields_draw_independently(self) -> None:
        alone = skies({"air": [0, 10]})[0]
        both = skies({"air": [0, 10], "dust": [0, 10], "haze": {"visibility_m": [10, 100]}})[0]
        assert alone.air == both.air != both.dust

    @pytest.mark.parametrize(("visibility_m", "veiled"), [(30_000, 0.01), (500, 0.33)])
    def test_haze_of_kilometres_leaves_the_zenith_clear(
        self, visibility_m: float, veiled: float
    ) -> None:
        haze = require(skies({"haze": {"visibility_m": visibility_m}})[0].haze)
        share = 1 - np.exp(-haze.extinction_per_m[1] * haze.thickness_m)
        assert share == pytest.approx(veiled, abs=0.01)

    def test_clouds_are_drawn_by_the_seed(self) -> None:
        section = {"clouds": {"cover": [0.2, 0.4]}}
        first, again, other = (require(skies(section, seed=seed)[0].clouds) for seed in (1, 1, 2))
        assert 0.2 <= first.cover <= 0.4
        assert first == again
        assert first.seed != other.seed
        assert first.thickness_m == 0.25 * first.size_m
        layer = {"clouds": {"kind": "stratocumulus", "thickness_m": [50, 60]}}
        assert 50 <= require(skies(layer)[0].clouds).thickness_m <= 60
        assert skies({})[0].clouds is None

    def test_a_batch_keeps_its_draw(self) -> None:
        assert len({sky.air for sky in skies({"air": [0, 10]}, samples=5)}) == 1

    def test_samples_draw_anew_at_their_interval(self) -> None:
        section = {"air": [0, 10], "redraw": "sample", "step_interval": 3}
        airs = [sky.air for sky in skies(section, samples=9)]
        assert airs[1] == airs[2] == airs[3] != airs[4] == airs[5] == airs[6] != airs[7] == airs[9]
        assert airs == [sky.air for sky in skies(section, samples=9)]

    @pytest.mark.parametrize(
        ("section", "fault"),
        [
            ({"air": 11}, "air"),
            ({"air": [2, 1]}, "least, most"),
            ({"sun_elevation_deg": [0, 91]}, "sun_elevation_deg"),
            ({"haze": {"visibility_m": 0}}, "visibility_m"),
            ({"hdri": {}}, "images or a folder"),
            ({"hdri": {"images": [{"file": "no_such_file.hdr"}]}}, "existing file"),
            ({"sky": {"model": "green"}}, "model"),
            ({"sky": {"model": "none"}, "clouds": {}}, "clouds"),
            ({"sun_from_time": {"date_time": "noon"}}, "date_time"),
        ],
    )
    def test_faults_are_told_by_their_path(self, section: dict[str, Any], fault: str) -> None:
        with pytest.raises(ConfigError, match=fault):
            config_from_mapping({"environment": section})


AT = {
    "date_time": "2003-10-17T12:30:30-07:00",
    "latitude_deg": 39.742476,
    "longitude_deg": -105.1786,
}


class TestSunFromTime:
    """A sun placed by time and place."""

    def test_it_overrides_the_angles(self) -> None:
        """Values as in NREL's worked example."""
        (sky,) = skies({"sun_elevation_deg": 1, "sun_from_time": AT})
        assert degrees(sky.sun_elevation_rad) == pytest.approx(90 - 50.11162, abs=0.01)
        assert degrees(sky.sun_azimuth_rad) == pytest.approx(90 - 194.34024, abs=0.01)

    def test_the_clock_runs_on(self) -> None:
        """15 degrees an hour around the pole."""
        at = {**AT, "latitude_deg": 90.0, "s_per_sample": 1800.0}
        seen = skies({"sun_from_time": at}, samples=5)
        turn = [degrees(sky.sun_azimuth_rad - seen[1].sun_azimuth_rad) for sky in seen[1:]]
        assert turn == pytest.approx([0, -7.5, -15, -22.5, -30], abs=0.01)

    @pytest.mark.parametrize(("latitude_deg", "side"), [(48.0, -1), (-48.0, 1)])
    def test_at_noon_the_sun_stands_towards_the_equator(
        self, latitude_deg: float, side: int
    ) -> None:
        """South, -y, in the north of the Earth, and the other way round; east in the morning."""
        at = {"latitude_deg": latitude_deg, "longitude_deg": 0.0}
        noon, morning = (
            skies({"sun_from_time": {**at, "date_time": f"2026-04-15T{hour}:00:00Z"}})[0].to_sun
            for hour in ("12", "07")
        )
        assert side * noon[1] > 0.5 > 10 * abs(noon[0])
        assert morning[0] > 0.7

    def test_it_is_the_sun_of_no_other_body(self) -> None:
        expected = r"environment\.sun_from_time.*ephemerides.*stage\.body is 2600000"
        with pytest.raises(ConfigError, match=expected):
            config_from_mapping({"stage": {"body": 2.6e6}, "environment": {"sun_from_time": AT}})
        config_from_mapping({"stage": {"body": 6.378e6}, "environment": {"sun_from_time": AT}})
        # Bodies and times of metadata meet in the world.
        module = EnvironmentModule(EnvironmentConfig.model_validate({"sun_from_time": AT}))
        world = World(surroundings=Surroundings(body_radius_m=2.6e6))
        with pytest.raises(InvalidInputError, match=r"sun_from_time.*Earth, the Moon or Mars"):
            module.step_batch(world, None, np.random.default_rng(1))

    def test_the_sun_of_the_moon_shines_by_its_distance(self) -> None:
        """NASA/JPL Horizons at longitude 0 and latitude 0: see `test_environment_sun`."""
        at = {"date_time": "2024-06-15T00:00:00Z", "latitude_deg": 0, "longitude_deg": 0}
        world = World(surroundings=Surroundings(body_radius_m=1.7374e6))
        module = EnvironmentModule(
            EnvironmentConfig.model_validate(
                {"sun_from_time": {**at, "s_per_sample": 43200.0}, "sky": {"model": "none"}}
            )
        )
        module.step_batch(world, None, np.random.default_rng(1))
        world.sample_id = 2
        module.step_sample(world, None, np.random.default_rng(1))
        sky = world.sky
        assert sky is not None
        assert degrees(sky.sun_elevation_rad) == pytest.approx(15.182862, abs=0.005)
        assert degrees(sky.sun_azimuth_rad) == pytest.approx(90 - 88.458421, abs=0.005)
        assert sky.sun_strength_w_m2 == pytest.approx(4 / 1.01644034**2, rel=1e-6)
        # 1919.26 seconds of arc at 1 au (Explanatory Supplement to the Astronomical Almanac).
        seconds = degrees(sky.sun_angular_diameter_rad) * 3600
        assert seconds == pytest.approx(1919.26 / 1.01644034, rel=1e-3)

    def test_a_place_is_needed(self) -> None:
        times = {"date_time": "2024-06-15T00:00:00Z"}
        with pytest.raises(ConfigError, match=r"latitude_deg: expected a number.*stage\.dem"):
            config_from_mapping({"environment": {"sun_from_time": times}})

    def test_true_north_may_lie_elsewhere(self) -> None:
        (plain,) = skies({"sun_from_time": AT})
        (turned,) = skies({"sun_from_time": {**AT, "north_offset_deg": 25}})
        assert turned.sun_azimuth_rad - plain.sun_azimuth_rad == pytest.approx(radians(25))


@pytest.fixture
def images(tmp_path: Path) -> Path:
    """A folder of two grey sky images and one map of labels: its left half red, the rest green."""
    for name, value in (("a", 0.25), ("b", 0.5)):
        assert cv2.imwrite(str(tmp_path / f"{name}.hdr"), np.full((8, 16, 3), value, np.float32))
    colors: NDArray[np.uint8] = np.full((32, 64, 3), GREEN[::-1], np.uint8)
    colors[:, :32] = RED[::-1]
    colors[:2] = BLUE[::-1]
    assert cv2.imwrite(str(tmp_path / "labels.png"), colors)
    return tmp_path


def mapped(folder: Path, **more: Any) -> dict[str, Any]:
    """A section with one image and its labels."""
    mapping = {
        "#ff0000": {"label": "hill", "semantic_id": 31},
        "#00ff00": {
            "label": "sea",
            "semantic_id": 32,
            "levels": [{"label": "water", "semantic_id": 42}],
        },
    }
    labels = [{"image": str(folder / "labels.png"), "mapping": mapping}]
    image = {"file": str(folder / "a.hdr"), "labels_from": labels}
    return {"sky_semantic_id": 7, "hdri": {"images": [image], **more}}


class TestHdri:
    """Lists of sky images."""

    @pytest.mark.parametrize("choose", ["random", "shuffle", "cycle"])
    def test_samples_choose_from_the_folder(self, images: Path, choose: str) -> None:
        hdri = {"folder": str(images), "choose": choose, "strength": [1, 2]}
        seen = skies({"hdri": hdri, "redraw": "sample"}, samples=40)[1:]
        names = [require(sky.hdri).image.name for sky in seen]
        assert set(names) == {"a", "b"}
        pairs = list(zip(names[::2], names[1::2], strict=True))
        if choose == "cycle":
            assert set(pairs) == {("a", "b")}
        if choose == "shuffle":
            assert set(pairs) == {("a", "b"), ("b", "a")}
        assert all(1 <= require(sky.hdri).strength <= 2 for sky in seen)

    def test_an_image_shown_again_is_the_same_object(self, images: Path) -> None:
        seen = skies({"hdri": {"folder": str(images)}}, samples=3)
        assert seen[0] == seen[3]

    def test_pixels_are_linear_and_one_may_be_named(self, images: Path) -> None:
        (sky,) = skies({"hdri": {"folder": str(images), "use": "b"}})
        np.testing.assert_allclose(require(sky.hdri).image.radiance, 0.5, rtol=0.01)
        with pytest.raises(InvalidInputError, match="one of a, b"):
            skies({"hdri": {"folder": str(images), "use": "c"}})

    def test_the_lamp_is_out_unless_kept(self, images: Path) -> None:
        hdri = {"folder": str(images)}
        assert skies({"hdri": hdri})[0].lamp_w_m2 == 0
        assert skies({"hdri": {**hdri, "keep_sun": True}})[0].lamp_w_m2 == 4

    def test_labels_follow_the_direction(self, images: Path) -> None:
        """The middle of an image looks along +x, its left half is on the side of +y."""
        (sky,) = skies(mapped(images))
        rays = np.array(
            [(0, 1, 0.1), (0, -1, 0.1), (-1, 1e-3, 0), (-1, -1e-3, 0), (0, 0, 1)], float
        )
        assert sky.semantic_ids_at(rays, 0).tolist() == [31, 32, 31, 32, 7]
        assert sky.semantic_ids_at(rays, 1).tolist() == [0, 42, 0, 42, 0]
        (turned,) = skies(mapped(images, rotation_deg=180))
        assert turned.semantic_ids_at(rays, 0).tolist() == [32, 31, 32, 31, 7]

    def test_names_of_mapped_labels_are_told(self, images: Path) -> None:
        module = EnvironmentModule(EnvironmentConfig.model_validate(mapped(images)))
        world = World()
        module.step_batch(world, None, np.random.default_rng(0))
        assert world.semantic_labels == {7: "sky", 31: "hill", 32: "sea", 42: "water"}

    def test_another_layout_is_refused(self, images: Path) -> None:
        cv2.imwrite(str(images / "square.hdr"), np.ones((8, 8, 3), np.float32))
        with pytest.raises(InvalidInputError, match="twice as wide"):
            skies({"hdri": {"folder": str(images), "use": "square"}})


class TestLabels:
    """Labels of pixels that hit nothing."""

    def test_ground_and_sky_part_at_the_horizon(self) -> None:
        ground = {"label": "far ground", "semantic_id": 8, "levels": [
            {"label": "ground", "semantic_id": 80}]}  # fmt: skip
        section = {"sky_semantic_id": 7, "ground_beyond_label": ground}
        (sky,) = skies(section)
        rays = np.array([(1, 0, 0.01), (1, 0, -0.01)])
        assert sky.semantic_ids_at(rays, 0).tolist() == [7, 8]
        assert sky.semantic_ids_at(rays, 1).tolist() == [0, 80]
        assert skies({"sky_semantic_id": 7})[0].semantic_ids_at(rays, 0).tolist() == [7, 7]


def test_an_id_has_one_name() -> None:
    with pytest.raises(ConfigError, match="semantic_id 1 is called both 'gravel' and 'sky'"):
        config_from_mapping({"environment": {"sky_semantic_id": 1}})


class Dimmer(effects.EnvironmentEffect):
    """An effect as another package may bring."""

    share: float

    def apply(self, sky: Sky, rng: np.random.Generator) -> Sky:
        """Dim the sky, and the sun at random."""
        strength = sky.sun_strength_w_m2 * float(rng.uniform())
        return replace(sky, sky_strength=sky.sky_strength * self.share, sun_strength_w_m2=strength)


class TestEffects:
    """Effects that entry points name."""

    @pytest.fixture(autouse=True)
    def _installed(self, monkeypatch: pytest.MonkeyPatch) -> None:
        point = EntryPoint("dimmer", f"{__name__}:Dimmer", extensions.EFFECTS)
        monkeypatch.setattr(extensions, "entry_points", lambda group, name="dimmer": [point])

    def test_they_change_the_sky_in_turn(self) -> None:
        dimmer = {"effect": "dimmer", "share": 0.5}
        section = {"effects": [dimmer, dimmer]}
        (sky,) = skies(section)
        assert sky.sky_strength == 0.25
        assert 0 < sky.sun_strength_w_m2 < 4
        assert skies(section, samples=1)[1] == sky

    @pytest.mark.parametrize(
        ("effect", "fault"),
        [
            ({"effect": "fog"}, "environment.effects.0.effect.*dimmer"),
            ({"effect": "dimmer"}, "environment.effects.0.share"),
            ({"effect": "dimmer", "share": 1, "rest": 2}, "environment.effects.0.rest"),
        ],
    )
    def test_faults_are_told_by_their_path(self, effect: dict[str, Any], fault: str) -> None:
        with pytest.raises(InvalidInputError, match=fault):
            skies({"effects": [effect]})


def simulation(images: Path) -> Simulation:
    """A simulation whose light changes from sample to sample."""
    environment = mapped(images, rotation_deg=[0, 360], strength=[0.5, 2])
    return Simulation(
        config_from_mapping(
            {
                "backend": "analytic",
                "stage": {"preset": "plane", "extent_m": 20, "resolution_px": 3},
                "materials": SMALL_MATERIALS,
                "assets": {"rocks": []},
                "sensors": {
                    "cameras": [
                        {"name": "c", "width_px": 64, "height_px": 48, "fx_px": 30, "fy_px": 30}
                    ]
                },
                "environment": {**environment, "redraw": "sample", "step_interval": 2},
            }
        )
    )


def test_a_restored_simulation_goes_on_as_before(images: Path) -> None:
    """Labels and colours of what follows are the same bytes, with metadata in force."""
    first, second = simulation(images), simulation(images)
    pose = {"pose": pose_looking_at((0, 0, 2), (1, 1, 2.2))}
    first.step_batch()
    first.step_sample(ModuleMetadata(sensor=pose, environment={"hdri": {"strength": [3, 4]}}))
    for _ in range(2):
        first.step_sample(ModuleMetadata(sensor=pose))
    second.restore(first.state())
    for _ in range(3):
        a = first.step_sample(ModuleMetadata(sensor=pose))
        b = second.step_sample(ModuleMetadata(sensor=pose))
        assert a.sample_id == b.sample_id
        for mine, other in zip(a.frames, b.frames, strict=True):
            assert (mine.data == other.data).all()
    seen = [first.step_sample(ModuleMetadata(sensor=pose)) for _ in range(4)]
    labels = [sample.frame("c", SEMANTIC_0).data.tobytes() for sample in seen]
    assert len(set(labels)) > 1


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"hdri": {"use": "c"}}, "environment.hdri.use"),
        ({"hdri": {"brightness": 1}}, "metadata.environment.hdri.brightness"),
        ({"air": [0, 99]}, "metadata.environment.air"),
        ({"effects": [{"effect": "unknown"}]}, "environment.effects.0.effect"),
        ({"sun_from_time": {"latitude_deg": 1}}, "metadata.environment.sun_from_time"),
    ],
)
def test_metadata_is_refused_before_anything_changes(
    images: Path, change: dict[str, Any], fault: str
) -> None:
    simulator = simulation(images)
    simulator.step_batch()
    before = simulator.state()
    with pytest.raises(InvalidInputError, match=fault):
        simulator.step_sample(ModuleMetadata(environment=change))
    assert simulator.state() == before


class TestOvercast:
    """A sky of thick clouds."""

    def test_light_on_level_ground_is_that_of_a_dull_day(self) -> None:
        for elevation_deg, klx in ((10.0, 3.95), (30.0, 10.8), (60.0, 18.49)):
            (sky,) = skies({"sky": {"model": "overcast"}, "sun_elevation_deg": elevation_deg})
            assert sky.lamp_w_m2 == 0
            # The sun above the air gives 133.3 klx, here 4 units.
            luminance = float(level_irradiance_w_m2(sky) @ LUMINANCE)
            assert luminance == pytest.approx(4 * klx / 133.3, rel=2e-3)

    def test_it_is_three_times_as_bright_above_as_at_the_horizon(self) -> None:
        (sky,) = skies({"sky": {"model": "overcast"}})
        directions = np.array([[0, 0, 1], [0, 0.75**0.5, 0.5], [1, 0, 0]])
        zenith, middle, horizon = gradient_radiance(sky.gradient, directions, np.array(sky.to_sun))
        assert zenith / horizon == pytest.approx(np.full(3, 3.0))
        assert middle / horizon == pytest.approx(np.full(3, 2.0))

    def test_the_night_is_dark(self) -> None:
        (sky,) = skies({"sky": {"model": "overcast"}, "sun_elevation_deg": -12.0})
        assert 0 < float(level_irradiance_w_m2(sky) @ LUMINANCE) < 1e-6

    def test_clouds_of_their_own_are_refused(self) -> None:
        with pytest.raises(ValueError, match="received overcast"):
            skies({"sky": {"model": "overcast"}, "clouds": {}})
