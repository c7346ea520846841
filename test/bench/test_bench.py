"""The benchmarks: their arithmetic against known numbers, and one topic run as a user does."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from repository import REPOSITORY

from oaisys_core.system.python_programs import python_command
from tools.bench.child import JobError, run_job
from tools.bench.figures import Figure, Goal, figure, ratio
from tools.bench.plots import plot_growth, plot_quality
from tools.bench.referees.module_process import run_module
from tools.bench.references import ReferenceImages, psnr_db, sha256, ssim
from tools.bench.report import cells, markdown, round_digits, write_results
from tools.bench.settings import Settings
from tools.bench.topics import growth, quality
from tools.programs import tool_environment

TIMEOUT_S = 300

KEYS = {"name", "unit", "median", "min", "max", "n"}


def noisy_pictures() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    picture = cv2.resize(rng.integers(0, 256, (12, 16, 3), np.uint8), (96, 72))
    noise = rng.normal(0, 9, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8), picture


def test_figures_tell_median_and_spread() -> None:
    odd, even = figure("odd", "s", [5, 1, 3]), figure("even", "ms", [4, 1, 2, 10])
    assert odd.to_dict() == {"name": "odd", "unit": "s", "median": 3, "min": 1, "max": 5, "n": 3}
    assert even.to_dict()["median"] == 3
    with pytest.raises(ValueError, match="at least one"):
        figure("none", "s", [])
    with pytest.raises(ValueError, match="expected numbers"):
        figure("nan", "s", [1.0, float("nan")])


@pytest.mark.parametrize(
    ("goal", "below", "at", "above"),
    [(Goal(2.0), True, True, False), (Goal(2.0, at_least=True), False, True, True)],
)
def test_goals_are_met_on_their_own_side(goal: Goal, below: bool, at: bool, above: bool) -> None:
    found = [figure("x", "s", [value], goal).is_met for value in (1.9, 2.0, 2.1)]
    assert found == [below, at, above]
    assert figure("x", "s", [1.0]).is_met is None


def test_a_ratio_is_against_the_median_of_the_fast_way() -> None:
    assert ratio("speedup", [30.0, 60.0], [1.0, 2.0, 90.0], None).values == (15.0, 30.0)


def test_psnr_is_opencvs() -> None:
    image, picture = noisy_pictures()
    assert psnr_db(image, picture) == pytest.approx(cv2.PSNR(image, picture), abs=1e-9)
    # One code value off everywhere: 20 log10(255).
    assert psnr_db(np.full((4, 5, 3), 7, np.uint8), np.full((4, 5, 3), 8, np.uint8)) == (
        pytest.approx(48.1308, abs=1e-4)
    )
    assert psnr_db(picture, picture) == float("inf")


def test_ssim_is_that_of_the_paper() -> None:
    image, picture = noisy_pictures()
    assert ssim(picture, picture) == pytest.approx(1.0)
    # Wang et al., eq. 13, with the Gaussian window of 11 pixels and sigma 1.5.
    found = []
    for channel in range(3):
        x, y = (each[..., channel].astype(np.float64) for each in (image, picture))
        mean_x, mean_y = blurred(x), blurred(y)
        var_x, var_y = blurred(x * x) - mean_x**2, blurred(y * y) - mean_y**2
        covariance = blurred(x * y) - mean_x * mean_y
        c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
        above = (2 * mean_x * mean_y + c1) * (2 * covariance + c2)
        below = (mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2)
        found.append((above / below).mean())
    assert ssim(image, picture) == pytest.approx(np.mean(found), abs=2e-3)
    assert ssim(image, picture) < 0.95


def blurred(image: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(image, (11, 11), 1.5)


def test_references_are_reused_for_the_same_key_alone(tmp_path: Path) -> None:
    _, picture = noisy_pictures()
    calls = []

    def render() -> tuple[float, np.ndarray]:
        calls.append(1)
        return 12.5, picture

    references = ReferenceImages(tmp_path)
    key = {"samples": 512, "pose": [0.0, 1.5]}
    first = references.get("nadir", key, render)
    again = references.get("nadir", dict(reversed(key.items())), render)
    assert (first.is_reused, again.is_reused, len(calls)) == (False, True, 1)
    assert again.seconds == 12.5
    assert np.array_equal(again.image, picture)
    references.get("nadir", key | {"samples": 64}, render)
    assert len(calls) == 2
    # Cut short before its facts were written: rendered again.
    for facts in tmp_path.glob("*.json"):
        facts.unlink()
    assert not references.get("nadir", key, render).is_reused
    assert sha256(picture) != sha256(picture[::-1])


def test_rocks_twice_as_many_are_compared_turn_by_turn() -> None:
    turns = [
        {"geometry": [0.2, 0.21], "preview": [1.0, 1.0]},
        {"geometry": [0.4, 0.44], "preview": [2.0, 2.5]},
    ]
    slower = growth.slower(1000, 2000, turns)
    assert [each.name for each in slower] == [
        f"rocks_1000_to_2000_{quality}_slower" for quality in ("geometry", "preview")
    ]
    assert slower[0].values == pytest.approx((5.0, 10.0))
    assert slower[1].values == pytest.approx((0.0, 25.0))


def colour(preset: str, seconds: float, psnr: tuple[float, ...]) -> list[Figure]:
    return [
        figure(f"{preset}_s", "s", [seconds], Goal(1.0)),
        figure(f"{preset}_psnr", "dB", psnr),
        figure(f"{preset}_psnr_worst_view", "dB", [min(psnr)], note="the view shadow"),
    ]


def test_results_are_written_whole_with_tables_and_plots(tmp_path: Path) -> None:
    figures = [*colour("preview", 0.8, (36, 30, 38)), *colour("standard", 2.0, (39, 41, 45))]
    assert quality.points(figures) == {"preview": (0.8, 36, 30), "standard": (2.0, 41, 39)}
    points = [Figure(f"rocks_{n}_preview_s", "s", (1.0,), curve="rocks", x=n) for n in (0, 2000)]
    points += [Figure(f"rocks_{n}_memory", "MB", (9e2,), curve="rocks", x=n) for n in (0, 2000)]
    by_topic = {"quality": figures, "growth": points}
    settings = Settings(tmp_path)
    write_results(settings, {"cores": "2"}, by_topic, {"budget": "no time"})
    records = json.loads((tmp_path / "bench.json").read_text())
    assert [record["name"] for record in records] == [each.name for each in figures + points]
    assert all(record.keys() >= KEYS for record in records)
    assert records[0] | {"goal": "≤ 1", "met": True} == records[0]
    page = (tmp_path / "bench.md").read_text()
    assert "| preview_psnr_worst_view | 30 | 30 | 30 | 1 | dB |  | the view shadow |" in page
    assert "## budget: failed" in page
    for name in ("quality.png", "growth.png"):
        picture = cv2.imread(str(tmp_path / name))
        assert picture is not None
        assert picture.std() > 5
    assert not list(tmp_path.glob("*.part"))


def test_plots_show_their_points(tmp_path: Path) -> None:
    one = plot_quality({"preview": (1.0, 36.0, 32.0)}, tmp_path / "one.png")
    two = plot_quality(
        {"preview": (1.0, 36.0, 32.0), "high": (7.0, 42.0, 40.0)}, tmp_path / "2.png"
    )
    assert not np.array_equal(cv2.imread(str(one)), cv2.imread(str(two)))
    sizes = [Figure(f"size_{n}_build_s", "s", (1.0,), curve="size", x=n) for n in (100, 200)]
    assert cv2.imread(str(plot_growth(sizes, tmp_path / "g.png"))) is not None


def test_numbers_are_short_and_without_exponents() -> None:
    assert [round_digits(value) for value in (0.012345, 1.23456, 123.456, 12345.6, 99.99512)] == [
        "0.01235",
        "1.235",
        "123.5",
        "12346",
        "99.9951",
    ]
    assert cells(figure("x", "s", [3.0], Goal(2.0), "why"))[-1] == "missed, why"
    assert "quick" in markdown(Settings(Path(), quick=True), {}, {}, {}, [])


def test_a_job_that_fails_tells_why(tmp_path: Path) -> None:
    with pytest.raises(JobError, match="nowhere"):
        run_job("nowhere.at_all", Settings(tmp_path), lambda _share, _text: None)


def test_tools_are_found_from_any_folder_and_nothing_is_imported_from_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("numpy", "json", "tools"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('planted')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", ":/packages:.")
    module, usage = "tools.bench.referees.rgbd_odometry", "usage: "
    found = tool_environment(tmp_path / "first")
    assert found["PYTHONPATH"].split(":") == [str(tmp_path / "first"), str(REPOSITORY), "/packages"]
    printed = subprocess.check_output(
        python_command(module, "--help"), cwd=tmp_path, env=found, text=True, timeout=TIMEOUT_S
    )
    assert printed.startswith(usage)
    assert run_module(module, "--help")[0].startswith(usage)


@pytest.mark.long
@pytest.mark.system
def test_one_topic_runs_as_a_user_runs_it(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tools.bench", "--only", "transfer", "--quick"]
    command += ["--runs", "1", "--size", "64x48", "--out", str(tmp_path)]
    done = subprocess.run(
        command, cwd=REPOSITORY, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    records = {each["name"]: each for each in json.loads((tmp_path / "bench.json").read_text())}
    for way in ("loopback", "shared_memory"):
        record = records[f"transfer_{way}_ms"]
        assert record.keys() >= KEYS
        assert record["n"] >= 5
        assert 0 < record["min"] <= record["median"] <= record["max"]
        assert records[f"transfer_{way}_call_ms"]["median"] >= record["median"]
    assert "transfer_loopback_ms" in (tmp_path / "bench.md").read_text()
    assert "transfer_loopback_ms" in done.stdout


def test_an_unknown_topic_is_refused(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tools.bench", "--only", "luck", "--out", str(tmp_path)]
    done = subprocess.run(
        command, cwd=REPOSITORY, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )
    assert done.returncode == 2
    assert "luck" in done.stderr
    assert not list(tmp_path.iterdir())
