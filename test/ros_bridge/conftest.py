"""Fixtures of tests with nodes: a user, and a stage with a user for servers and nodes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from ros_peer import Stage, User


@pytest.fixture
def user(ros_domain_id: int) -> Iterator[User]:
    """A user in a ROS domain of the test."""
    user = User()
    yield user
    user.close()


@pytest.fixture
def stage(tmp_path: Path, ros_domain_id: int, no_process_left: None) -> Iterator[Stage]:
    """A stage in a ROS domain of the test; what is started on it must end with the test."""
    with Stage(tmp_path) as stage:
        yield stage
