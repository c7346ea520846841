"""A data set that all tests of this folder may read, and an S3 server."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import boto3
import pytest
from rendered_datasets import write_rendered_dataset
from small_datasets import SCANNED, render_dataset
from waiting import PATIENCE_S, START_PATIENCE_S, wait_until

from oaisys_dataset import Dataset, open_dataset


@pytest.fixture(scope="session")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Three worlds of two views each, rendered by the analytic backend; not to be changed."""
    folder = tmp_path_factory.mktemp("rendered") / "set"
    write_rendered_dataset(folder)
    return open_dataset(folder)


@pytest.fixture(scope="session")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Two worlds of three views, seen by a camera and three lidars; not to be changed.

    `front` scans every other view.
    """
    folder = tmp_path_factory.mktemp("scanned") / "set"
    render_dataset(folder, {0: "train", 1: "val"}, 3, SCANNED)
    return open_dataset(folder)


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[str]:
    """The URL of a bucket on an S3 server of its own."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    variables = {
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_EC2_METADATA_DISABLED": "true",
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
    }
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    with (tmp_path / "moto.log").open("wb") as log:
        server = subprocess.Popen(command, stdout=log, stderr=log, env=os.environ)
    try:
        wait_until(lambda: _listens(port), START_PATIENCE_S, process=server)
        boto3.client("s3").create_bucket(Bucket="worlds")
        yield "s3://worlds"
    finally:
        server.terminate()
        server.wait(PATIENCE_S)


def _listens(port: int) -> bool:
    with socket.socket() as client:
        return client.connect_ex(("127.0.0.1", port)) == 0
