"""The shell commands about bags, without a bag or node."""

from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner

from oaisys_ros_bridge.commands import bag_app


def test_two_rules_for_one_topic_are_refused(tmp_path: Path) -> None:
    """ROS would follow the first one and drop the other without a word."""
    rules = ["--remap", "/a:=/b", "--remap", "/c:=/d", "--remap", "/a:=/e"]
    ended = CliRunner().invoke(bag_app, ["replay", str(tmp_path / "no.mcap"), *rules])
    assert ended.exit_code == 2
    text = " ".join(ended.output.replace("│", " ").split())
    assert "--remap" in text
    assert "received /a:=/b, /a:=/e, expected one rule for each topic" in text
