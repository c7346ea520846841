"""Filters of entities are checked by themselves, whatever else they let through."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_msgs.msg import Vector3
from simulation_interfaces.msg import Bounds, EntityFilters, TagsFilter

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.simulation_interfaces.entities import Entity, EntityFilter

RIG = Entity("base_link", "", 1, "rig", ("rig",), np.eye(4))
NOBODY = TagsFilter(tags=["x"])


def bounds(kind: int, *points: tuple[float, float, float]) -> Bounds:
    return Bounds(type=kind, points=[Vector3(x=x, y=y, z=z) for x, y, z in points])


@pytest.mark.parametrize(
    "unusable",
    [
        bounds(255),
        bounds(Bounds.TYPE_CONVEX_HULL, (0, 0, 0)),
        bounds(Bounds.TYPE_BOX),
        bounds(Bounds.TYPE_SPHERE, (0, 0, 0)),
        bounds(Bounds.TYPE_BOX, (0, 0, 0), (np.nan, 0, 0)),
        bounds(Bounds.TYPE_BOX, (0, 0, 0), (1, 0, 0), (2, 0, 0)),
    ],
)
def test_unusable_bounds_are_refused_whatever_passes_the_other_filters(unusable: Bounds) -> None:
    for others in ({}, {"tags": NOBODY}, {"filter": "^nobody$"}):
        with pytest.raises(InvalidInputError, match=r"filters\.bounds\."):
            EntityFilter(EntityFilters(bounds=unusable, **others))


def test_an_unknown_mode_of_tags_is_refused_without_tags_too() -> None:
    with pytest.raises(InvalidInputError, match=r"filters\.tags\.filter_mode.*7"):
        EntityFilter(EntityFilters(tags=TagsFilter(filter_mode=7)))


@pytest.mark.parametrize(
    "text", ["(.|.|.|.|.|.|.|.|.|.|.|.|.|.|.|.|.|.)*!", r"(\w|\w|\w)*!", "(a*)*!"]
)
def test_expressions_that_backtrack_take_no_time(text: str) -> None:
    long = Entity("a" * 4000, "", 1, "", (), np.eye(4))
    assert EntityFilter(EntityFilters(filter=text)).passing([RIG, long], None) == []


@pytest.mark.parametrize("text", ["cam(", "(?=x)", r"(a)\1", "a{100000}", "[[:none:]]"])
def test_expressions_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(InvalidInputError, match=r"filters\.filter.*RE2"):
        EntityFilter(EntityFilters(filter=text))


def test_names_of_classes_are_those_of_posix() -> None:
    wanted = EntityFilter(EntityFilters(filter="^base_[[:alpha:]]+$"))
    assert wanted.passing([RIG], None) == [RIG]
    assert wanted.is_by_box is False
    assert EntityFilter(EntityFilters()).is_by_box
