"""Files of others under the names of Fast DDS's ports: said before ROS opens them."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from waiting import PATIENCE_S

from oaisys_core.errors import OaisysError
from oaisys_ros_bridge import namespaces
from oaisys_ros_bridge.namespaces import claim_domain
from oaisys_ros_bridge.shared_memory import (
    SHARED_MEMORY,
    foreign_ports,
    require_safe_ports,
    require_shared_memory,
)

NOBODY = 65534
DOMAIN = 61
PORT = 7400 + 250 * DOMAIN + 11

AS_NOBODY = f"""
import os, sys
from pathlib import Path
from oaisys_ros_bridge.shared_memory import foreign_ports, require_safe_ports
os.setuid({NOBODY})
folder, domain = Path(sys.argv[1]), int(sys.argv[2])
assert list(foreign_ports(domain, folder))
require_safe_ports(domain, folder)
"""

needs_root = pytest.mark.skipif(os.getuid() != 0, reason="only root plants files of others")


@pytest.mark.parametrize(
    "name", [f"fastrtps_port{PORT}", f"fastrtps_port{PORT}_el", "fastrtps_port7000_sl"]
)
def test_a_link_is_refused_by_name_and_never_followed(name: str, tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    (tmp_path / name).symlink_to(victim)
    with pytest.raises(OaisysError, match=f"{name} is a link or another user's"):
        require_safe_ports(DOMAIN, tmp_path)
    assert not victim.exists()


@needs_root
def test_a_port_of_another_user_is_refused_unless_a_program_listens_there(tmp_path: Path) -> None:
    port, lock = tmp_path / f"fastrtps_port{PORT}", tmp_path / f"fastrtps_port{PORT}_el"
    for path in (port, lock, tmp_path / f"sem.fastrtps_port{PORT}_mutex"):
        path.touch()
        os.chown(path, NOBODY, NOBODY)
    with pytest.raises(OaisysError, match="no program of theirs uses it: remove it"):
        require_safe_ports(DOMAIN, tmp_path)
    with lock.open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        require_safe_ports(DOMAIN, tmp_path)
    assert len(list(foreign_ports(DOMAIN, tmp_path))) == 3


@needs_root
def test_files_of_this_user_and_of_other_domains_are_none_of_others(tmp_path: Path) -> None:
    (tmp_path / f"fastrtps_port{PORT}").touch()
    beside = tmp_path / f"fastrtps_port{PORT + 250}"
    beside.touch()
    os.chown(beside, NOBODY, NOBODY)
    (tmp_path / "fastrtps_porthole").symlink_to(tmp_path)
    require_safe_ports(DOMAIN, tmp_path)
    assert not list(foreign_ports(DOMAIN, tmp_path))


@needs_root
def test_a_domain_with_files_of_another_user_is_not_claimed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(namespaces, "_CLAIM", f"\0oaisys-test-{os.getpid()}-{{}}")
    monkeypatch.setattr(namespaces, "LARGEST_DOMAIN", 2)
    monkeypatch.setattr(namespaces, "foreign_ports", lambda n: foreign_ports(n, tmp_path))
    planted = tmp_path / f"fastrtps_port{7400 + 250 + 10}"
    planted.touch()
    os.chown(planted, NOBODY, NOBODY)
    for _ in range(5):
        with claim_domain() as number:
            assert number == 2


def test_a_pipe_under_a_name_of_lttng_is_refused(tmp_path: Path) -> None:
    """It was opened when rclpy was loaded, which no signal ended."""
    require_shared_memory(tmp_path)
    os.mkfifo(tmp_path / "lttng-ust-wait-6")
    with pytest.raises(OaisysError, match="lttng-ust-wait-6 is a pipe"):
        require_shared_memory(tmp_path)


@needs_root
def test_a_port_that_this_user_may_not_write_to_is_left_to_its_user() -> None:
    """Fast DDS takes another one then."""
    with tempfile.TemporaryDirectory(dir=SHARED_MEMORY) as folder:
        Path(folder).chmod(0o755)
        (Path(folder) / f"fastrtps_port{PORT}").touch(mode=0o644)
        subprocess.run([sys.executable, "-c", AS_NOBODY, folder, str(DOMAIN)], check=True)


@pytest.mark.ros
@needs_root
@pytest.mark.parametrize("program", ["bridge", "mapper"])
def test_a_node_ends_with_a_sentence_where_a_port_is_planted(
    program: str, ros_domain_id: int
) -> None:
    """Fast DDS waited for ever for the mutex of such a port, and no signal ended it."""
    planted = SHARED_MEMORY / f"fastrtps_port{7400 + 250 * ros_domain_id + 211}"
    planted.write_bytes(bytes(4096))
    os.chown(planted, NOBODY, NOBODY)
    try:
        command = [sys.executable, "-P", "-m", f"oaisys_ros_bridge.nodes.{program}"]
        ended = subprocess.run(
            command, capture_output=True, text=True, timeout=PATIENCE_S, check=False
        )
        assert ended.returncode == 2
        assert f"{planted} is a link or another user's" in ended.stderr + ended.stdout
        assert "Traceback" not in ended.stderr
    finally:
        planted.unlink()
