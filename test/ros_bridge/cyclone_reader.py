"""A program of Cyclone DDS, without ROS: prints size and sum of the first depth image it hears.

Before, it prints that it knows the image's writer: from then on it misses none.
"""

import os
import sys
import time
from dataclasses import dataclass
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import int32, sequence, uint8, uint32
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PATIENCE_S = 90.0


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]  # type: ignore[type-arg]


def main(topic: str) -> int:
    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(5))
    reader = DataReader(participant, Topic(participant, topic, Image), qos=qos)
    end_s = time.monotonic() + PATIENCE_S
    while not reader.get_matched_publications():
        if time.monotonic() > end_s:
            return 1
        time.sleep(0.05)
    sys.stdout.write("matched\n")
    sys.stdout.flush()
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        taken: list[Any] = reader.take(1)
        for image in taken:
            total = sum(image.data)
            sys.stdout.write(f"{image.width}x{image.height} {image.encoding} {total}\n")
            return 0
        time.sleep(0.05)
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
