"""ROS domains: claimed by one process at a time, of any user, without a file."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE_S

from oaisys_core.errors import OaisysError
from oaisys_ros_bridge import namespaces
from oaisys_ros_bridge.namespaces import claim_domain

CLAIM_AS = """
import os, sys
from oaisys_ros_bridge.namespaces import claim_domain
os.setuid(int(sys.argv[1]))
with claim_domain() as number:
    print(number, flush=True)
    sys.stdin.read()
"""


def test_links_of_others_among_the_temporary_files_are_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A claim was a file that was opened for writing: a link there had its target truncated."""
    victim = tmp_path / "victim"
    victim.write_text("kept")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    planted = tmp_path / f"oaisys-ros-domains-{os.getuid()}"
    planted.mkdir()
    for number in range(1, namespaces.LARGEST_DOMAIN + 1):
        (planted / str(number)).symlink_to(victim)
    with claim_domain():
        pass
    assert victim.read_text() == "kept"


def test_a_claim_ends_with_its_block(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(namespaces, "_CLAIM", f"\0oaisys-test-{os.getpid()}-{{}}")
    monkeypatch.setattr(namespaces, "LARGEST_DOMAIN", 2)
    with claim_domain() as first:
        with claim_domain() as second, pytest.raises(OaisysError, match="all ROS domains"):
            claim_domain().__enter__()
        assert {first, second} == {1, 2}
        with claim_domain() as again:
            assert again == second


@pytest.mark.skipif(os.getuid() != 0, reason="only root becomes another user")
def test_two_users_get_different_domains_until_one_is_killed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each user had a folder of claims of its own, so that two could claim the same domain."""
    other = subprocess.Popen(
        [sys.executable, "-c", CLAIM_AS, "65534"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert other.stdin is not None
    assert other.stdout is not None
    number = int(other.stdout.readline())
    try:
        monkeypatch.setattr("random.SystemRandom.sample", lambda *_: [number])
        with pytest.raises(OaisysError, match="all ROS domains"):
            claim_domain().__enter__()
        other.kill()
        other.wait(PATIENCE_S)
        with claim_domain() as claimed:
            assert claimed == number
    finally:
        other.kill()
        other.communicate()
