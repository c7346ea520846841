"""Fixtures for every test: a ROS domain of its own, and a check that no process is left behind."""

from __future__ import annotations

import gc
import os
import signal
import uuid
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import hypothesis
import psutil
import pytest
from blender_process import end_shared_blender
from leak_check import MARK, LeakCheck

# Before any test imports Open3D: Blender may then be imported after it.
import oaisys_core  # noqa: F401
from oaisys_core.system import fallbacks

LONGEST_ID = 60
"""Characters of a parameter that a test's name shows."""

SELECTED_MARKS = {"long", "soak"}
"""Marks whose tests have a target of their own, and which each file names that has such a test."""

TESTS = Path(__file__).parent
LONGEST_FILES = (
    "core/config/test_examples.py",
    "ros_bridge/experiments/test_survey.py",
    "ros_bridge/subscribing/test_lossless.py",
    "dataset/rendering/test_engine.py",
    "ros_bridge/experiments/test_explore.py",
    "system/test_examples_run.py",
    "ros_bridge/experiments/test_node_planner.py",
    "dataset/rendering/test_gpu_workers.py",
    "core/config/test_config_properties.py",
    "system/test_setup_interfaces.py",
    "grpc/server/supervision/test_reliability_blender.py",
    "core/render/test_drawn_worlds.py",
    "core/config/test_expectations.py",
)
"""Files whose tests take far longer than others, the longest first."""

SLOW_MARKS = {"blender", "long", "ros", "system"}
SLOW_FIXTURES = {"start_server", "flat_server", "leaks", "no_process_left"}
"""Of tests that start processes, which take seconds each."""

# A shell's background job ignores SIGINT, and so would the programs that tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples on every run: a change is judged by what it changed. Others are drawn with
# HYPOTHESIS_PROFILE=default.
hypothesis.settings.register_profile("repeatable", derandomize=True)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


def pytest_configure(config: pytest.Config) -> None:
    """Let SIGTERM end tests in order: else their nodes outlive the claim of their ROS domain.

    What failed until then is reported.
    """
    _answer_signals()

    def end(*_: object) -> None:
        if distribution := config.pluginmanager.getplugin("dsession"):  # xdist's, with workers
            distribution.shouldstop = "terminated"
            for worker in psutil.Process().children():
                worker.terminate()
        else:
            pytest.exit("terminated")

    signal.signal(signal.SIGTERM, end)
    gc.disable()  # while tests are collected


def _answer_signals() -> None:
    """Undo that a shell ignores signals for what it runs in the background."""
    for number, usual in (
        (signal.SIGINT, signal.default_int_handler),
        (signal.SIGQUIT, signal.SIG_DFL),
    ):
        if signal.getsignal(number) == signal.SIG_IGN:
            signal.signal(number, usual)


def pytest_collection_finish() -> None:
    """Keep collections of garbage from going through all modules and tests again and again."""
    gc.collect()
    gc.freeze()
    gc.enable()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file without the mark that is asked for: two of three files have no long test."""
    mark = config.option.markexpr
    is_test = collection_path.match("test_*.py") and mark in SELECTED_MARKS
    return True if is_test and f"mark.{mark}" not in collection_path.read_text("utf-8") else None


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> Generator[None]:
    """Begin with the files that take longest: the last one must not keep one worker alone busy.

    Holds where files go to workers in the order in which they were collected.
    """
    _require_named_marks(items)
    if gone := [name for name in LONGEST_FILES if not (TESTS / name).is_file()]:
        raise pytest.UsageError(f"LONGEST_FILES: received {gone}, expected files in {TESTS}")
    yield  # tests are deselected
    slow_tests = Counter(item.path for item in items if _is_slow(item))
    place = {TESTS / name: number for number, name in enumerate(LONGEST_FILES)}
    items.sort(key=lambda item: (place.get(item.path, len(place)), -slow_tests[item.path]))


def _require_named_marks(items: list[pytest.Item]) -> None:
    """Fail where a file's text does not name a mark of its tests: it would be run by nobody."""
    marked = {(i.path, mark.name) for i in items for mark in i.iter_markers() if _is_selected(mark)}
    for path, name in sorted(marked):
        if f"mark.{name}" not in path.read_text("utf-8"):
            raise pytest.UsageError(f"{path}: received a test marked {name}, expected mark.{name}")


def _is_selected(mark: pytest.Mark) -> bool:
    return mark.name in SELECTED_MARKS


def _is_slow(item: pytest.Item) -> bool:
    fixtures = getattr(item, "fixturenames", ())
    marks = {mark.name for mark in item.iter_markers()}
    return not (SLOW_MARKS.isdisjoint(marks) and SLOW_FIXTURES.isdisjoint(fixtures))


def pytest_sessionfinish() -> None:
    """End the process of Blender that tests have shared."""
    end_shared_blender()


def pytest_make_parametrize_id(val: object) -> str | None:
    """Name a long text by its beginning and length: names are sent, kept and printed many times."""
    if isinstance(val, str | bytes) and len(val) > LONGEST_ID:
        return f"{val[:LONGEST_ID]!a} of {len(val)}"
    return None


@pytest.fixture
def ros_domain_id(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A `ROS_DOMAIN_ID` that no other test of this machine uses; set for child processes too."""
    from oaisys_ros_bridge.namespaces import DOMAIN_VARIABLE, claim_domain

    with claim_domain() as domain_id:
        monkeypatch.setenv(DOMAIN_VARIABLE, str(domain_id))
        yield domain_id


@pytest.fixture
def fallback_lines(caplog: pytest.LogCaptureFixture) -> Iterator[Callable[[], list[str]]]:
    """What is written to the log, from now on, about parts of libraries that cannot be used."""
    fallbacks.report_fallback.cache_clear()
    yield lambda: [each.getMessage() for each in caplog.records if each.name == fallbacks.__name__]
    fallbacks.report_fallback.cache_clear()


def claim_domain_first(request: pytest.FixtureRequest) -> None:
    """Keep a test's ROS domain from others until none of its processes is left in it."""
    if "ros_domain_id" in request.fixturenames:
        request.getfixturevalue("ros_domain_id")


@pytest.fixture
def no_process_left(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[None]:
    """Fail a test that leaves processes running, and end them.

    They are known by a mark in their environment, so orphans are found too.
    """
    claim_domain_first(request)
    mark = str(uuid.uuid4())
    monkeypatch.setenv(MARK, mark)
    yield
    left = LeakCheck(mark).left_behind()
    assert not left, f"left behind: {left}"


@pytest.fixture
def leaks(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[LeakCheck]:
    """Fail a test whose processes leave anything: themselves, shared memory, sockets, ports.

    To be asked for before what starts processes, so that it looks last.
    """
    claim_domain_first(request)
    mark = str(uuid.uuid4())
    monkeypatch.setenv(MARK, mark)
    with LeakCheck(mark) as check:
        yield check
    left = check.left_behind()
    assert not left, f"left behind: {left}"
