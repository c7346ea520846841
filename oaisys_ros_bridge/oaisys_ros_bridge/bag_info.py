"""What is in a recorded bag."""

from __future__ import annotations

import struct
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader

from oaisys_core.errors import InvalidInputError

FINISHED = "a finished MCAP file; `oaisys bag recover` saves what one holds that was cut short"


def summary_of(path: Path) -> list[str]:
    """Return one line per topic (name, type, messages), below a line of the whole.

    Args:
        path: A bag's folder with one ``.mcap`` file in it, or that file.

    Raises:
        InvalidInputError: There is no such file, or it is not a finished MCAP file.
    """
    file = mcap_file(path)
    try:
        with file.open("rb") as stream:
            summary = make_reader(stream).get_summary()
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
    total = f"{file}: {statistics.message_count} messages, {span_s:.1f} s"
    return [total, *(f"  {topic:<{width}}  {kind}  {count}" for topic, kind, count in rows)]


def mcap_file(path: Path) -> Path:
    """Return a bag's one file, given that or its folder; `InvalidInputError` if there is none."""
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if len(files) != 1 or not files[0].is_file():
        raise InvalidInputError("bag", str(path), "a folder with one .mcap file, or that file")
    return files[0]
