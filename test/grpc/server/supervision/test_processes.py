"""What a worker inherits, and which addresses are served."""

import os
import sys

import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_grpc.addresses import check_address
from oaisys_grpc.server.supervision.worker_process import worker_environment

ROS_ENVIRONMENT = {
    "PATH": "/bin",
    "LD_LIBRARY_PATH": "/ros/lib",
    "AMENT_PREFIX_PATH": "/ros",
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
    "PYTHONPATH": "/ros/packages",
}


def test_another_interpreter_gets_nothing_of_this_environment() -> None:
    found = worker_environment("/other/bin/python", ROS_ENVIRONMENT)
    assert found["PATH"] == "/bin"
    assert {"LD_LIBRARY_PATH", "AMENT_PREFIX_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}.isdisjoint(
        found
    )
    assert "/ros/packages" not in found["PYTHONPATH"].split(os.pathsep)


def test_this_interpreter_keeps_its_environment() -> None:
    found = worker_environment(sys.executable, ROS_ENVIRONMENT)
    assert found["LD_LIBRARY_PATH"] == "/ros/lib"
    assert found["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] == "1"
    assert "/ros/packages" in found["PYTHONPATH"].split(os.pathsep)


@pytest.mark.parametrize(
    "address", ["127.0.0.1:0", "localhost:50051", "[::1]:50051", "unix:/run/simulator"]
)
def test_addresses_of_this_machine_are_served(address: str) -> None:
    check_address(address, insecure=False, encrypted=False)


@pytest.mark.parametrize("address", ["", "127.0.0.1", "127.0.0.1:99999", "127.0.0.1:http"])
def test_an_address_without_a_port_is_none(address: str) -> None:
    with pytest.raises(InvalidInputError, match="HOST:PORT"):
        check_address(address, insecure=True, encrypted=False)


@pytest.mark.parametrize("address", ["0.0.0.0:0", "192.168.0.5:50051", "[::]:50051", "host:1"])
def test_addresses_that_others_reach_need_consent(address: str) -> None:
    with pytest.raises(InvalidInputError, match="--insecure"):
        check_address(address, insecure=False, encrypted=False)
    check_address(address, insecure=True, encrypted=False)
