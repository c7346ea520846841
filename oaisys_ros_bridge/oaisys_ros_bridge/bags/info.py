"""What is in a recorded bag."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap.summary import Summary

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.bags.losses import METADATA_NAME, BagLosses
from oaisys_ros_bridge.namespaces import TF

SAMPLE_INFO_TYPE = "oaisys_msgs/msg/SampleInfo"
TF_TYPE = "tf2_msgs/msg/TFMessage"
FINISHED = "a finished MCAP file; `oaisys bag recover` saves what one holds that was cut short"


def summary_of(path: Path) -> list[str]:
    """Return one line per topic (name, type, messages), below a line of the whole.

    Transforms that a bridge has repeated between samples are told apart from those of samples.
    Where a recorder of ours wrote it, what it lacks of the announced samples follows.

    Args:
        path: A bag's folder with one ``.mcap`` file in it, or that file.

    Raises:
        InvalidInputError: There is no such file, or it is not a finished MCAP file.
    """
    file = mcap_file(path)
    try:
        with file.open("rb") as stream:
            reader = make_reader(stream)
            summary = reader.get_summary()
            repeats = {} if summary is None else repeats_of(reader, summary)
            losses = _losses(reader)
    except (McapError, struct.error) as error:  # where there is no footer it reads anything
        raise InvalidInputError("bag", str(file), FINISHED) from error
    if summary is None or summary.statistics is None:
        raise InvalidInputError("bag", str(file), FINISHED)
    statistics = summary.statistics
    span_s = (statistics.message_end_time - statistics.message_start_time) / 1e9
    counts = statistics.channel_message_counts
    rows = sorted(
        (channel.topic, summary.schemas[channel.schema_id].name, counts.get(channel.id, 0))
        for channel in summary.channels.values()
    )
    width = max((len(topic) for topic, _, _ in rows), default=0)
    lines = [f"{file}: {statistics.message_count} messages, {span_s:.1f} s"]
    for topic, kind, count in rows:
        repeated = repeats.get(topic, 0)
        also = f" and {repeated} repeats" if repeated else ""
        lines.append(f"  {topic:<{width}}  {kind}  {count - repeated}{also}")
    if losses is not None:
        lines += [f"  {sentence}" for sentence in losses.sentences]
    return lines


def losses_of(path: Path) -> BagLosses | None:
    """Return what a bag says it lacks; None: it does not tell.

    Raises:
        InvalidInputError: There is no such file, or it is not a finished MCAP file.
    """
    file = mcap_file(path)
    try:
        with file.open("rb") as stream:
            return _losses(make_reader(stream))
    except (McapError, struct.error) as error:
        raise InvalidInputError("bag", str(file), FINISHED) from error


def _losses(reader: McapReader) -> BagLosses | None:
    entries = [r.metadata for r in reader.iter_metadata() if r.name == METADATA_NAME]
    return BagLosses.read(entries[0]) if entries else None


def repeats_of(reader: McapReader, summary: Summary) -> Mapping[str, int]:
    """Return how many messages of each ``/tf`` only repeat the last sample's transforms.

    These are the ones whose stamp no ``~/sample_info`` has. Nothing is known, and nothing
    returned, of a bag without that topic.
    """
    kinds = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
    moving = [t for t, kind in kinds.items() if kind == TF_TYPE and t.endswith(TF)]
    samples = [topic for topic, kind in kinds.items() if kind == SAMPLE_INFO_TYPE]
    if not samples:
        return {}
    told: set[bytes] = set()
    stamps: list[tuple[str, bytes]] = []
    for _, channel, message in reader.iter_messages(topics=[*moving, *samples]):
        # CDR: 4 bytes of header; a stamp of 8 bytes, or the number of transforms before it.
        if channel.topic in samples:
            told.add(message.data[4:12])
        else:
            stamps.append((channel.topic, message.data[8:16]))
    found = dict.fromkeys(moving, 0)
    for topic, stamp in stamps:
        found[topic] += stamp not in told
    return found


def mcap_file(path: Path) -> Path:
    """Return a bag's one file, given that or its folder; `InvalidInputError` if there is none."""
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if len(files) != 1 or not files[0].is_file():
        raise InvalidInputError("bag", str(path), "a folder with one .mcap file, or that file")
    return files[0]
