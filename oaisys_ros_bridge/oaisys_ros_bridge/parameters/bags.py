"""The parameters of recorder and player; those of the other nodes are in `parameters`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.parameters.table import Changeable, ParameterRow, ParameterTable


def _exclude_is_an_expression(values: Mapping[str, Any]) -> None:
    try:
        re.compile(values["exclude"])
    except re.error as error:
        raise InvalidInputError("exclude", values["exclude"], f"an expression: {error}") from None


RECORDER = ParameterTable(
    (
        ParameterRow(
            "path",
            "",
            "Folder of the bag, new or empty; empty: a new bag_DATE.",
            changeable=Changeable.AT_START,
        ),
        ParameterRow(
            "topics",
            [""],
            "Topics to record, waited for at the start; none: all.",
            changeable=Changeable.AT_START,
        ),
        ParameterRow(
            "all",
            False,
            "Whether all others of the namespace are recorded beside the topics, too.",
            changeable=Changeable.AT_START,
        ),
        ParameterRow(
            "exclude",
            r".*/(compressed(Depth)?|image_color)",
            "Regular expression of the topics that are not recorded unless they are named.",
            changeable=Changeable.AT_START,
        ),
        ParameterRow(
            "duration_s",
            0.0,
            "When it ends by itself; 0: never.",
            unit="s",
            least=0.0,
            changeable=Changeable.AT_START,
        ),
    ),
    rules=(_exclude_is_an_expression,),
)
"""The recorder's parameters. *All* are those of its own namespace and those of all the machine;
compressed images and colours of labels hold nothing that the others do not, and are computed for
whoever listens."""

PLAYER = ParameterTable(
    (
        ParameterRow("path", "", "The bag.", changeable=Changeable.AT_START),
        ParameterRow(
            "rate",
            1.0,
            "How much faster than it was recorded.",
            least=1e-3,
            most=1e3,
            changeable=Changeable.AT_START,
        ),
        ParameterRow(
            "loop", False, "Whether it begins again at the end.", changeable=Changeable.AT_START
        ),
        ParameterRow(
            "topics", [""], "Topics to publish; none: all.", changeable=Changeable.AT_START
        ),
        ParameterRow(
            "clock_hz",
            0.0,
            "How often the time of the recording is published on /clock; 0: never.",
            unit="Hz",
            least=0.0,
            most=1e3,
            changeable=Changeable.AT_START,
        ),
        ParameterRow(
            "wait_for_topics",
            [""],
            "Topics that must have a reader before the first message; none: those of topics.",
            changeable=Changeable.AT_START,
        ),
        ParameterRow(
            "wait_for_readers",
            0,
            "Nodes that must read any of the topics before the first message.",
            least=0,
            most=10_000,
            changeable=Changeable.AT_START,
        ),
        ParameterRow(
            "wait_timeout_s",
            10.0,
            "How long readers may take to come; then it ends with an error. Where none are named, "
            "it waits for one on each topic, and then plays to those that came.",
            unit="s",
            least=0.0,
            most=86_400.0,
            changeable=Changeable.AT_START,
        ),
        ParameterRow(
            "delay_s",
            0.0,
            "When to begin, whoever is there by then, after the readers that wait_for_topics and "
            "wait_for_readers ask for; 0: when the readers are there.",
            unit="s",
            least=0.0,
            most=86_400.0,
            changeable=Changeable.AT_START,
        ),
    )
)
"""The player's parameters."""
