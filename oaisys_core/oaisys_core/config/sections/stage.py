"""Configuration of the ground.

Lengths are in metres, angles in degrees.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, StringConstraints, model_validator

from oaisys_core.config.section import Latitude, Longitude, Position, Positive, Section
from oaisys_core.config.sections.erosion import ErosionConfig
from oaisys_core.config.sections.water import WaterConfig
from oaisys_core.files.path_fields import ConfigFile, NamedPath
from oaisys_core.geometry import MAX_M

Body = Literal["earth", "moon", "mars"] | Annotated[float, Field(ge=1e3, le=1e9)]
"""A body, or its radius in metres."""

RADIUS_M = {"earth": 6.371e6, "moon": 1.7374e6, "mars": 3.3895e6}
"""Mean radii."""

BODY_TOLERANCE = 0.01
"""Relative difference of two radii of the same body."""


def body_name(body: Body) -> str | None:
    """Return the name of a body that is given by name or radius; None for an unknown radius."""
    if isinstance(body, str):
        return body
    named = (name for name, known in RADIUS_M.items() if abs(body / known - 1) <= BODY_TOLERANCE)
    return next(named, None)


LEAST_EXTENT_M = 0.01
"""Least edge length of a stage."""

MAX_PX = 8193
"""Largest number of points along an edge of a ground."""

StageName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,127}$")]
"""A name that cannot be a path."""


class DemWindowConfig(Section):
    """The part of a large GeoTIFF that becomes the ground; nothing else of its heights is read.

    Attributes:
        size_m: Width along the file's columns and height along its rows, in true metres.
        centre_lon_lat_deg: Longitude and latitude of its middle; null for the middle of the file.
    """

    size_m: tuple[Positive, Positive]
    centre_lon_lat_deg: tuple[Longitude, Latitude] | None = None


class DemConfig(Section):
    """A digital elevation model: a raster such as a GeoTIFF, or a grey image.

    Attributes:
        file: A raster that GDAL reads from one file (GeoTIFF, ``.asc``, ``.hgt``, ``.img``, ...),
            an EXR image, or a grey PNG, JPEG or other image, first row in the north.
        spacing_m: Distance between pixels; None uses that of the file, in true metres on its body.
        size_m: Size of an image in x, y and z, as ``<size>`` of an SDF ``<heightmap>``: between the
            outer pixels, and the height of its largest value; 0 is at ``position_m``. It goes
            without ``spacing_m``, ``scale`` and ``height_unit``.
        position_m: Position of the model's centre, and what is added to its heights, as ``<pos>``
            of an SDF ``<heightmap>``.
        scale: Factor on the heights, in addition to that in the file.
        offset_m: Offset added to the heights; None moves the median height to z = 0.
        height_unit: Unit of the heights after ``scale``; None uses that of the file, metres of an
            image.
        nodata: Stored value or values of missing heights, in addition to what the file says;
            ``none``: every other value is a height. None: values that look like missing heights are
            an error.
        crs: Reference system of the coordinates, such as ``EPSG:32633`` or WKT; None uses that of
            the file.
        ground_spacing_m: Distance between grid points of the ground; None uses that of the pixels.
        band: Band of a raster, or channel of an image; None uses the first, unless it is a
            colour's.
        window: The part of a GeoTIFF with a reference system of a body that is used; null for all.
            The whole file may then be larger than other images.
    """

    file: ConfigFile
    spacing_m: Positive | None = None
    size_m: tuple[Positive, Positive, Positive] | None = None
    position_m: Position = (0.0, 0.0, 0.0)
    scale: float = 1.0
    offset_m: float | None = None
    height_unit: Literal["m", "ft", "us-ft"] | None = None
    nodata: float | tuple[float, ...] | Literal["none"] | None = None
    crs: str | None = Field(default=None, max_length=10_000)
    ground_spacing_m: Positive | None = None
    band: int | None = Field(default=None, ge=1)
    window: DemWindowConfig | None = None

    @model_validator(mode="after")
    def _one_size(self) -> DemConfig:
        if self.window is not None and (self.spacing_m or self.size_m):
            raise ValueError(
                "window has the file's own pixel size: expected no spacing_m or size_m"
            )
        if self.size_m is not None and self.spacing_m is not None:
            raise ValueError("expected spacing_m or size_m, not both")
        # Written configurations have every key, so that values count.
        for name, plain in (("scale", 1.0), ("height_unit", None)):
            if self.size_m is not None and getattr(self, name) != plain:
                raise ValueError(f"expected {name} or size_m, whose z scales the heights, not both")
        return self


class StageMeshConfig(Section):
    """A mesh as ground: .obj, .glb, .gltf, .ply, .stl, .blend, .dae or USD; scripts never run.

    Attributes:
        file: The file.
        object: Name of the object in the file; None for all of them.
        scale: Metres per unit of the file.
        up: Axis that points up, after .glb and .gltf (y up) and COLLADA and USD (as they say) were
            rotated to z up; .obj files are taken as z up, as in ROS's tools.
        position_m: Position of its origin.
    """

    file: ConfigFile
    object: str | None = None
    scale: Positive = 1.0
    up: Literal["x", "y", "z"] = "z"
    position_m: Position = (0.0, 0.0, 0.0)


class DetailConfig(Section):
    """Finer ground around the cameras, for depth, labels, colour and queries alike.

    Attributes:
        radius_m: Half the edge of the refined square, which moves in steps of half this length.
        spacing_m: Distance between its points.
        amplitude_m: Amplitude of the relief that the coarse ground cannot represent.
        gain: Amplitude of each octave relative to the coarser one.
        below_m: Height of the cameras above the ground up to which it is refined.
        textures: Factor on the relief of the ground's textures, which casts shadows and is in
            depth as far as the refined ground shows it; 0 for none, 1 for that of their normals.
    """

    radius_m: Positive = 4.0
    spacing_m: Positive = 0.02
    amplitude_m: float = Field(default=0.012, ge=0)
    gain: float = Field(default=0.6, gt=0, le=1)
    below_m: Positive = 30.0
    textures: float = Field(default=1.0, ge=0, le=10)


class ReuseConfig(Section):
    """A stored stage, used instead of a new one.

    Attributes:
        name: Its hash, or its name in the store; or the hash of the current stage.
        file: File of a stage, instead of a name.
        objects: Whether to keep the objects, draw new ones, or remove them.
    """

    name: StageName | None = None
    file: ConfigFile | None = None
    objects: Literal["keep", "redraw", "clear"] = "redraw"

    @model_validator(mode="after")
    def _one_source(self) -> ReuseConfig:
        if (self.name is None) == (self.file is None):
            raise ValueError("expected either a name or a file")
        return self


class StageConfig(Section):
    """The ground.

    Attributes:
        preset: Kind of terrain, see ``oaisys_core.procedural.terrain.presets``.
        extent_m: Edge length of the square stage, centred on the map's origin.
        resolution_px: Number of grid points along an edge.
        relief_m: Height difference of the large forms; None for the default of the preset. Of
            ``craters`` it is the depth of the largest one, which is fresh and five times as wide,
            so that no crater is stretched: at most 0.176 of ``extent_m``, or the log has a warning.
        roughness: Factor on the fine relief; 0 is smooth, 1 is the default of the preset.
        dem: Digital elevation model, instead of a preset.
        mesh: Mesh from a file, instead of a preset.
        erosion: Water and gravity that shape the preset or the elevation model; None for none.
        surroundings: What the ground beyond the stage is: ``land`` with relief as on the stage and
            larger forms behind, up to the horizon, or ``plain``, to which the stage slopes down;
            walls and pits that the edge cuts fade on it within a fraction of their width.
            Exactly flat ground has a plain around it. See also ``environment.ground_beyond``.
        body: Whose curvature the land beyond the stage has: ``earth``, ``moon``, ``mars``, or the
            radius of another body in metres. What a configuration does not say is the body's, too:
            ``environment.sky`` is black on the Moon and of dust on Mars, ``materials.layers`` are
            regolith, or red sand and black gravel, and ``assets.rock_texture`` is basalt.
        water: Lakes, ponds or a sea; None for none.
        detail: Finer ground around the cameras; None for no refinement.
        store: Folder in which the stage of each batch is stored by its hash, so that later runs can
            reuse it; relative to the working directory. None stores nothing.
        save_as: Additional name under which the stage of a batch is stored.
        reuse: A stored stage; None for a new one in each batch.
    """

    preset: str = "mounds"
    extent_m: float = Field(default=64.0, ge=LEAST_EXTENT_M, le=MAX_M)
    resolution_px: int = Field(default=1025, ge=2, le=MAX_PX)
    relief_m: float | None = Field(default=None, ge=0, le=MAX_M)
    roughness: float = Field(default=1.0, ge=0, le=10)
    dem: DemConfig | None = None
    mesh: StageMeshConfig | None = None
    erosion: ErosionConfig | None = None
    surroundings: Literal["land", "plain"] = "land"
    body: Body = "earth"
    water: WaterConfig | None = None
    detail: DetailConfig | None = None
    store: NamedPath | None = None
    save_as: StageName | None = None
    reuse: ReuseConfig | None = None

    @property
    def body_radius_m(self) -> float:
        """Radius of the body."""
        return RADIUS_M[self.body] if isinstance(self.body, str) else self.body

    @model_validator(mode="after")
    def _consistent(self) -> StageConfig:
        if self.dem is not None and self.mesh is not None:
            raise ValueError("expected dem or mesh, not both")
        if self.mesh is not None and self.detail is not None:
            raise ValueError("expected no detail on a mesh: only grids can be refined")
        if self.mesh is not None and self.erosion is not None:
            raise ValueError("expected no erosion of a mesh: only grids erode")
        if self.save_as is not None and self.store is None:
            raise ValueError("expected a store, because save_as is given")
        return self
