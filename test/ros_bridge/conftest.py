"""Fixtures of tests with nodes: a user, and a stage with a user for servers and nodes."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
from leak_check import MARK, LeakCheck
from ros_peer import Stage, User

from oaisys_ros_bridge.namespaces import DOMAIN_VARIABLE, claim_domain


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


@pytest.fixture(scope="module")
def ros_of_module() -> Iterator[None]:
    """A ROS domain of the module, whose processes must end with it."""
    mark = str(uuid.uuid4())
    with claim_domain() as domain_id, pytest.MonkeyPatch.context() as environment:
        environment.setenv(DOMAIN_VARIABLE, str(domain_id))
        environment.setenv(MARK, mark)
        yield
        left = LeakCheck(mark).left_behind()
    assert not left, f"left behind: {left}"


@pytest.fixture(scope="module")
def shared_stage(tmp_path_factory: pytest.TempPathFactory, ros_of_module: None) -> Iterator[Stage]:
    """A stage in the ROS domain of the module."""
    with Stage(tmp_path_factory.mktemp("stage")) as stage:
        yield stage
