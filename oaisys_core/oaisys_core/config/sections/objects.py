"""Configuration of single objects, with shapes that are built in or from files.

Lengths are in metres, angles in degrees.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from oaisys_core.config.section import (
    Labelled,
    Metres,
    PlaceInDegrees,
    Position,
    Quaternion,
    Scale,
    Section,
    TileEdge,
)
from oaisys_core.files.path_fields import ConfigFile, ConfigPath

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,63}$")]
Fraction = Annotated[float, Field(ge=0, le=1)]
Anchor = Literal["origin", "base"]


class ShapedConfig(Labelled):
    """The appearance of an object: either a built-in shape or a mesh from a file.

    Attributes:
        shape: Built-in shape, see ``oaisys_core.procedural.scatter.shapes``.
        file: A .obj, .glb, .gltf, .ply, .stl, .blend, .dae or USD file; its scripts never run.
        object_name: Name of the object in a file with several; None for all of them.
        up_axis: Axis of the file that points up. None: y in .glb and .gltf, what COLLADA and USD
            files say, and z in all others, as in ROS's tools; Blender takes .obj files as y up.
        texture: Built-in texture set projected onto it; None uses ``rock_texture`` for rocks and
            the shape's own colours for all others.
        tile_m: Edge length of a tile of the texture; None uses ``rock_tile_m``.
        color_srgb: Uniform colour instead of the shape's own colours and of any texture.
    """

    shape: str | None = None
    file: ConfigFile | None = None
    object_name: str | None = None
    up_axis: Literal["y", "z"] | None = None
    texture: str | None = None
    tile_m: TileEdge | None = None
    color_srgb: tuple[Fraction, Fraction, Fraction] | None = None

    @model_validator(mode="after")
    def _one_source(self) -> ShapedConfig:
        if (self.shape is None) == (self.file is None):
            raise ValueError("expected either a shape or a file")
        return self


class PlacedObjectConfig(ShapedConfig):
    """An object at a fixed pose.

    Attributes:
        position_m, quat_xyzw: Pose in ``map`` of its anchor.
        anchor: The point of a file's mesh that is placed: ``base`` is the centre of the bottom of
            its bounding box, ``origin`` that of the file's coordinates. Built-in shapes have their
            origin at their base.
        on_ground: Whether z is relative to the ground below.
        scale: Factor on its own size in metres; rocks and plants are 1 m large.
        hidden: Whether it is invisible; it keeps its instance id.
    """

    position_m: Position
    quat_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)
    on_ground: bool = False
    anchor: Anchor = "base"
    scale: Scale = 1.0
    hidden: bool = False


class ObjectConfig(PlacedObjectConfig):
    """An object at a fixed pose.

    Attributes:
        name: Unique name, which is also the key of its metadata and random stream.
    """

    name: Name


class TrajectoryConfig(Section):
    """The poses of a mover at each sample: along waypoints, or from a CSV file.

    Attributes:
        waypoints_m: (x, y) or (x, y, z) points in ``map``; z defaults to 0.
        waypoints_lon_lat_deg: (longitude, latitude) or (longitude, latitude, elevation in m) points
            instead, on an elevation model that says where it lies; z defaults to 0, too.
        closed: Whether the path returns to its start; otherwise the mover stops at the last point.
        smooth: Whether the path is a spline through the points instead of straight lines.
        step_m: Distance along the path from one sample to the next.
        speed_m_s: Speed in timed drives, where it replaces ``step_m``; null moves by samples there,
            too.
        start_m: Distance along the path at the start of the batch.
        csv: CSV file in the format of ``poses.csv``. The first row is the pose at the start of the
            batch, each sample uses the next one. After the last row the mover stops, or starts
            again if ``closed``.
    """

    waypoints_m: tuple[tuple[Metres, Metres] | Position, ...] = ()
    waypoints_lon_lat_deg: tuple[PlaceInDegrees, ...] = ()
    closed: bool = False
    smooth: bool = False
    step_m: float = Field(default=0.5, ge=0)
    speed_m_s: float | None = Field(default=None, ge=0, le=1000)
    start_m: float = Field(default=0.0, ge=0)
    csv: ConfigPath | None = None

    @model_validator(mode="after")
    def _one_way(self) -> TrajectoryConfig:
        given = (self.waypoints_m, self.waypoints_lon_lat_deg)
        ways = sum(map(bool, (*given, self.csv)))
        points = self.waypoints_m or self.waypoints_lon_lat_deg
        if ways != 1 or (self.csv is None and len(points) < 2):
            expected = "at least two waypoints_m or waypoints_lon_lat_deg, or a csv file"
            raise ValueError(f"expected {expected}, one of them")
        if self.csv is not None and self.speed_m_s is not None:
            raise ValueError("speed_m_s needs waypoints_m: a csv file has a pose for each sample")
        if any(a == b for a, b in pairwise([*points, *(points[:1] if self.closed else ())])):
            raise ValueError("two waypoints in a row are the same")
        return self


class MoverConfig(ShapedConfig):
    """An object that moves from sample to sample, with its x axis forward.

    Attributes:
        name: Unique name, which is also the key of its metadata and random stream.
        trajectory: The poses at each sample.
        on_ground: Whether its height and tilt follow the ground; otherwise they come from the
            waypoints or the CSV file.
        anchor: The point of a file's mesh that moves along: see `PlacedObjectConfig`.
        scale: Factor on its own size in metres.
        hidden: Whether it is invisible; it keeps its instance id.
    """

    name: Name
    trajectory: TrajectoryConfig
    on_ground: bool = True
    anchor: Anchor = "base"
    scale: Scale = 1.0
    hidden: bool = False
