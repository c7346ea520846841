"""``oaisys view`` beside real servers and nodes, its page in a real browser."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
import yaml
from browser import browser_page
from certificates import Authority
from explore_runs import recorder_of
from served_simulator import FLAT_WORLD, MOUNDS, Server
from waiting import START_PATIENCE_S, wait_until

from oaisys_core.geometry import T_LINK_OPTICAL, pose_looking_at
from oaisys_core.types import PinholeIntrinsics
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.report.web_viewer import PosedImages, point_cloud_of

CAMERA = PinholeIntrinsics(64, 48, 54.0, 54.0, 31.5, 23.5)
COMMAND = [sys.executable, "-m", "oaisys_core"]


@contextmanager
def watching(folder: Path, *options: str) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """A running ``oaisys view`` and the file that its standard output goes to."""
    out = folder / "view.out"
    command = [*COMMAND, "view", "--port", "0", "--save", str(folder / "scene.html"), *options]
    with out.open("w") as output, (folder / "view.err").open("w") as errors:
        process = subprocess.Popen(command, stdout=output, stderr=errors)
    try:
        said(process, out, "view: ")
        yield process, out
    finally:
        process.kill()
        process.wait()


def said(process: subprocess.Popen[bytes], out: Path, beginning: str) -> str:
    """Wait for a line and return what follows its beginning."""

    def line() -> str | None:
        lines = out.read_text(encoding="utf-8").splitlines()
        return next((line for line in lines if line.startswith(beginning)), None)

    found: str = wait_until(
        line, START_PATIENCE_S, process=process, explain=out.with_suffix(".err").read_text
    )
    return found.removeprefix(beginning)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with Server(tmp_path_factory.mktemp("server") / "flat", FLAT_WORLD) as server:
        yield server


@pytest.mark.long
def test_what_others_render_is_shown_over_grpc(server, tmp_path):
    with (
        watching(tmp_path, "--address", server.address) as (process, out),
        browser_page(tmp_path / "browser", (480, 360)) as page,
        server.client() as client,
    ):
        url = said(process, out, "view: ")
        page.open(url)
        client.step_batch(seed=2)
        for x_m in (-4.0, 4.0):
            client.render_sample(pose_looking_at((x_m, -4, 4), (0, 0, 0)))
        said(process, out, "2 views, ")
        page.wait_for("document.body.innerText.includes('2 views; the newest, ')")
        assert "from (4.0, -4.0, 4.0) m" in page.value("document.body.innerText")
        assert page.value("document.querySelectorAll('canvas').length") >= 1
        # Colour, depth and classes at the side.
        assert page.wait_for("document.querySelectorAll('img').length >= 3")
        assert page.errors == []
        hosts = {urlsplit(a).netloc for a in page.requests if a.startswith("http")}
        assert hosts == {urlsplit(url).netloc}
        process.send_signal(signal.SIGINT)
        assert process.wait(START_PATIENCE_S) == 0
    triangles = int(said(process, out, "2 views, ").split()[0])
    assert triangles > 1000
    # The scene's own page holds a whole viewer, and what was shown.
    assert (tmp_path / "scene.html").stat().st_size > 1_000_000


NEVER_STOPPING = """
import sys, time, viser
viser.ViserServer.stop = lambda server: time.sleep(3600)
from oaisys_core.cli.main import main
sys.argv[0] = "oaisys"
main()
"""


@pytest.mark.long
def test_a_page_that_cannot_be_stopped_holds_up_no_end_once_the_scene_is_saved(server, tmp_path):
    with server.client() as client:
        client.step_batch(seed=2)
        client.render_sample(pose_looking_at((-4, -4, 4), (0, 0, 0)))
    scene = tmp_path / "scene.html"
    options = ["--address", server.address, "--port", "0", "--views", "1", "--save", str(scene)]
    result = subprocess.run(
        [sys.executable, "-c", NEVER_STOPPING, "view", *options],
        capture_output=True,
        text=True,
        timeout=START_PATIENCE_S,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.splitlines()[-1] == f"saved: {scene}"
    assert scene.stat().st_size > 1_000_000


@pytest.mark.long
@pytest.mark.ros
@pytest.mark.usefixtures("no_process_left")
def test_a_survey_is_watched_over_ros_and_says_why_it_fails(tmp_path, ros_domain_id):
    """Its images make no map that agrees, and its recorder ends early."""
    world, survey_said, out = tmp_path / "world.yaml", tmp_path / "said", tmp_path / "survey"
    world.write_text(yaml.safe_dump(MOUNDS), encoding="utf-8")
    # More than are waited for: the view may join the graph after the first one is published.
    small = ("--views", "4", "--size", "24x18", "--voxel-size", "0.3", "--no-faults")
    # Neither does a survey need colour.
    options = ("--config", str(world), "--out", str(out), "--quality", "geometry", *small)
    # The recorder has ended long before the last sample is there.
    slow = {"OAISYS_FAULT": "late-slow:10@4", "OAISYS_TEST_BUILD": "1"}
    with (
        watching(tmp_path, "--ros", "--views", "2") as (process, shown),
        survey_said.open("w") as output,
        subprocess.Popen(
            [*COMMAND, "survey", *options],
            stdout=output,
            stderr=output,
            env={**os.environ, **slow, "ROS_DOMAIN_ID": str(ros_domain_id)},
        ) as survey,
    ):
        try:
            wait_until(
                lambda: "rendered in" in survey_said.read_text(),
                START_PATIENCE_S,
                process=survey,
                explain=survey_said.read_text,
            )
            recorder_of(survey).send_signal(signal.SIGTERM)
            code = survey.wait(START_PATIENCE_S)
        finally:
            survey.kill()
        assert process.wait(START_PATIENCE_S) == 0
    # On a busy machine, several views come at once.
    lines = [line.split() for line in shown.read_text(encoding="utf-8").splitlines()]
    counts = [(int(line[0]), int(line[2])) for line in lines if line[1:2] == ["views,"]]
    assert counts[-1][0] >= 2
    assert max(triangles for _, triangles in counts) > 1000
    assert (tmp_path / "scene.html").is_file()

    told = survey_said.read_text()
    assert code == 1, told
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert not report["closed"]
    assert report["lost"] == ["/oaisys_recorder had ended before the last sample"]
    assert "missed: /oaisys_recorder had ended" in told
    assert "missed: completion_ratio" in told
    assert "no picture" in told


@pytest.mark.long
def test_a_server_that_encrypts_is_shown(tmp_path):
    authority = Authority(tmp_path)
    cert, key = authority.pair("server")
    tls = ["--tls-cert", str(cert), "--tls-key", str(key)]
    with Server(tmp_path / "server", FLAT_WORLD, *tls) as server:
        options = ["--address", server.address, "--tls-ca", str(authority.ca)]
        with watching(tmp_path, *options) as (process, _):
            process.send_signal(signal.SIGINT)
            assert process.wait(START_PATIENCE_S) == 0


def test_a_server_that_is_not_there_is_told_in_one_line(tmp_path):
    result = subprocess.run(
        [*COMMAND, "view", "--address", "127.0.0.1:9", "--port", "0"],
        capture_output=True,
        text=True,
        timeout=START_PATIENCE_S,
        check=False,
    )
    assert result.returncode == 1
    assert "127.0.0.1:9" in result.stderr
    assert "Traceback" not in result.stderr


def test_clouds_lie_where_depth_says_and_leave_out_the_sky():
    depth_m = np.full((48, 64), 5.0, np.float32)
    depth_m[:24] = np.inf
    depth_m[24, :8] = 50.0
    rgb = np.zeros((48, 64, 3), np.uint8)
    rgb[..., 0] = np.arange(64)
    view = PosedImages("1", rgb, depth_m, None, PosedCamera(CAMERA, T_LINK_OPTICAL))
    points_m, colors_rgb = point_cloud_of(view, 20.0, 10_000)
    assert len(points_m) == len(colors_rgb) == 24 * 64 - 8
    np.testing.assert_allclose(points_m[:, 2], 5.0)
    np.testing.assert_allclose(points_m[:, 0], (colors_rgb[:, 0] - 31.5) / 54 * 5, atol=1e-5)
    few, _ = point_cloud_of(view, 20.0, 200)
    assert 0 < len(few) <= 200
