"""Set-up of a machine without ROS: what it does, what it refuses, and what it leaves behind."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from repository import REPOSITORY

from tools.setup import checks
from tools.setup.checks import check_compiler, check_disk
from tools.setup.environment import _SCRIPT, Environment
from tools.setup.errors import OptionalStepError, SetupError
from tools.setup.programs import Display, Programs
from tools.setup.steps import SetupStep, digest, run_stages

PREFIX = Path(sys.prefix)
SCRIPT = PREFIX / "oaisys_env.sh"


def run(stages: list[list[SetupStep]], stamps: Path) -> bool:
    return run_stages(stages, stamps, Programs(Display()))


def test_step_runs_once_and_again_when_its_key_changes(tmp_path: Path) -> None:
    done_before: list[bool] = []
    worked = [
        run([[SetupStep("step", "working", key, done_before.append)]], tmp_path)
        for key in ("a", "a", "b")
    ]
    assert done_before == [False, True]
    assert worked == [True, False, True]


def test_an_environment_s_own_python_and_its_base_make_the_same_set_up() -> None:
    """One that is first on PATH made it, its base found it changed: all was built twice."""
    code = "from tools.setup.environment import INTERPRETER; print(INTERPRETER)"
    base = Path(sys.base_prefix, "bin", f"python{sys.version_info.major}.{sys.version_info.minor}")
    keys = {
        subprocess.run(
            [python, "-c", code], cwd=REPOSITORY, stdout=subprocess.PIPE, check=True
        ).stdout
        for python in (sys.executable, base)
    }
    assert len(keys) == 1


def test_step_that_fails_is_not_stamped(tmp_path: Path) -> None:
    runs: list[bool] = []

    def fail_at_first(done_before: bool) -> None:
        runs.append(done_before)
        if len(runs) == 1:
            raise SetupError("no")

    step = SetupStep("step", "working", "key", fail_at_first)
    with pytest.raises(SetupError):
        run([[step]], tmp_path)
    run([[step]], tmp_path)
    run([[step]], tmp_path)
    assert len(runs) == 2


def test_optional_step_that_fails_stops_nothing_and_is_tried_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    done: list[str] = []

    def fail(_done_before: bool) -> None:
        done.append("tried")
        raise OptionalStepError("no npm")

    stages = [
        [SetupStep("three", "a", "key", fail)],
        [SetupStep("last", "b", "key", lambda _: done.append("ran"))],
    ]
    run(stages, tmp_path)
    run(stages, tmp_path)
    assert done == ["tried", "ran", "tried"]
    assert "left out: no npm" in capsys.readouterr().err


def test_steps_of_a_stage_run_at_the_same_time(tmp_path: Path) -> None:
    both = threading.Barrier(2, timeout=60)

    def meet(_done_before: bool) -> None:
        both.wait()

    run([[SetupStep(name, name, "key", meet) for name in "ab"]], tmp_path)
    assert {file.name for file in tmp_path.iterdir()} == {"a", "b"}


def test_a_step_that_fails_ends_the_programs_of_its_stage(tmp_path: Path) -> None:
    programs = Programs(Display())
    log = tmp_path / "log"
    started = threading.Event()

    def fail(_done_before: bool) -> None:
        assert started.wait(60)
        raise SetupError("no")

    def sleep(_done_before: bool) -> None:
        started.set()
        programs.run(["sleep", "600"], os.environ, log)

    steps = [SetupStep("a", "a", "key", sleep), SetupStep("b", "b", "key", fail)]
    with pytest.raises(SetupError, match="no"):
        run_stages([steps], tmp_path / "stamps", programs)
    assert not (tmp_path / "stamps").exists()


def test_digest_changes_with_a_file_below_a_folder(tmp_path: Path) -> None:
    (tmp_path / "msg").mkdir()
    (tmp_path / "msg" / "A.msg").write_text("int32 x")
    before = digest(tmp_path)
    assert digest(tmp_path) == before
    (tmp_path / "msg" / "A.msg").write_text("int64 x")
    assert digest(tmp_path) != before


def test_full_disk_is_refused_with_both_figures(tmp_path: Path) -> None:
    check_disk(tmp_path / "not" / "there", 0.0)
    with pytest.raises(SetupError, match=r"GB free, 1000000 GB needed"):
        check_disk(tmp_path / "not" / "there", 1e6)
    check_disk(tmp_path, 1e6, held_gb=lambda: 1e6)


def test_the_first_library_that_does_not_load_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "_MODULES", ("json", "not_there", "not_there_either"))
    monkeypatch.setattr(checks, "_missing_debian_packages", lambda _: [])
    with pytest.raises(SetupError, match=r"^not_there cannot be imported: .*No module named"):
        checks.check_libraries(Environment(PREFIX))
    monkeypatch.setattr(checks, "_MODULES", ("json", "csv"))
    checks.check_libraries(Environment(PREFIX))


def test_missing_and_broken_compilers_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check_compiler()
    broken = tmp_path / "cc"
    broken.write_text("#!/bin/sh\necho 'x.c:1: fatal error: stdio.h: no such file' >&2; exit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    with pytest.raises(SetupError, match=r"does not work: .*stdio\.h"):
        check_compiler()
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", str(tmp_path / "empty"))
    with pytest.raises(SetupError, match="no C compiler found"):
        check_compiler()


def test_unusable_interpreters_are_named_in_one_line(tmp_path: Path) -> None:
    for tool in ("bash", "dirname", "env"):
        (tmp_path / tool).symlink_to(Path("/usr/bin", tool))
    for name, answer in (("python3", "is 3.12"), ("python3.13", "Segmentation fault")):
        fake = tmp_path / name
        fake.write_text(f"#!/usr/bin/env bash\necho '{answer}' >&2; exit 1\n")
        fake.chmod(0o755)
    result = subprocess.run(
        [REPOSITORY / "tools" / "setup.sh"],
        env={"PATH": str(tmp_path), "VENV": str(tmp_path / "venv")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 1
    assert len(result.stderr.splitlines()) == 1
    assert f"{tmp_path}/python3 is 3.12, {tmp_path}/python3.13 does not run" in result.stderr
    assert not (tmp_path / "venv").exists()


def test_nothing_of_the_wheels_points_at_their_build_machine() -> None:
    result = subprocess.run(
        ["grep", "-rlI", "/opt/python/cp", PREFIX / "share"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.stdout == ""


def test_script_sets_the_environment_and_survives_a_read_only_home(tmp_path: Path) -> None:
    paths = ("LD_LIBRARY_PATH", "AMENT_PREFIX_PATH")
    variables = (*paths, "ROS_DISTRO", "ROS_LOG_DIR", "PYTHONPATH", "PYTHONDONTWRITEBYTECODE")
    show = "; ".join(f'echo "${{{name}-unset}}"' for name in variables)
    result = subprocess.run(
        ["bash", "-euc", f"source '{SCRIPT}'; command -v python; {show}"],
        env={
            "PATH": os.defpath,
            "HOME": "/nonexistent",
            "TMPDIR": str(tmp_path),
            "PYTHONPATH": "/opt/ros/jazzy/lib/python3.12/site-packages",
            "PYTHONDONTWRITEBYTECODE": "1",
        },
        capture_output=True,
        text=True,
        check=True,
    )
    python, libraries, prefix, distro, logs, *others = result.stdout.splitlines()
    assert Path(python) == PREFIX / "bin" / "python"
    assert libraries.split(":")[0] == str(PREFIX / "lib")
    assert all(Path(folder).is_dir() for folder in libraries.split(":"))
    assert (prefix, distro) == (str(PREFIX), "jazzy")
    assert others == ["unset", "unset"]
    assert logs.startswith(str(tmp_path))


TF2_MSGS = {
    "action/LookupTransform": "0b8adf6bc0b5958879e3265b41a457e03558fe523890a81252c70eba97a82c5d",
    "msg/TF2Error": "db2485e7d6a0ec75bf087e058ee45df682acc3a621ca7780503d10aac141809a",
    "msg/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "srv/FrameGraph": "0d1fbc6222c018ba5f33822904a2fdd4063705289956d3fdde07cd8c50fe8067",
}
"""Type hashes, as a ROS 2 install shows that of TFMessage by ``ros2 topic info -v /tf``."""


@pytest.mark.parametrize("name", TF2_MSGS)
def test_what_tf2_ros_imports_is_the_official_one(name: str) -> None:
    module, kind = name.split("/")
    assert hasattr(importlib.import_module(f"tf2_msgs.{module}"), kind)
    definition = json.loads((PREFIX / "share" / "tf2_msgs" / f"{name}.json").read_text())
    hashes = {entry["type_name"]: entry["hash_string"] for entry in definition["type_hashes"]}
    assert hashes[f"tf2_msgs/{name}"] == f"RIHS01_{TF2_MSGS[name]}"


PROMISED_INTERFACES = {
    "srv.SetPose.Request": {
        "pose": "geometry_msgs/PoseStamped",
        "sensor": "string",
        "modalities": "sequence<string>",
    },
    "srv.SetPose.Response": {
        "success": "boolean",
        "message": "string",
        "batch_id": "uint32",
        "sample_id": "uint32",
        "stamp": "builtin_interfaces/Time",
        "render_time": "double",
        "render_duration": "builtin_interfaces/Duration",
    },
    "srv.StepBatch.Request": {
        "seed": "int64",
        "reuse_stage": "boolean",
        "metadata_json": "string",
    },
    "srv.StepBatch.Response": {"success": "boolean", "message": "string", "batch_id": "uint32"},
    "srv.SetMetadata.Request": {"module": "string", "metadata_json": "string"},
    "srv.SetMetadata.Response": {"success": "boolean", "message": "string"},
    "action.Sweep.Goal": {"poses": "geometry_msgs/PoseArray"},
    "action.Sweep.Result": {
        "success": "boolean",
        "message": "string",
        "sample_ids": "sequence<uint32>",
    },
    "action.Sweep.Feedback": {
        "index": "uint32",
        "total": "uint32",
        "render_time": "double",
        "render_duration": "builtin_interfaces/Duration",
    },
}


@pytest.mark.parametrize("name", PROMISED_INTERFACES)
def test_interfaces_have_the_promised_fields(name: str) -> None:
    module, *path = name.split(".")
    interface = importlib.import_module(f"oaisys_msgs.{module}")
    for part in path:
        interface = getattr(interface, part)
    fields = interface.get_fields_and_field_types()
    assert dict(fields) == PROMISED_INTERFACES[name]


SIMULATION_INTERFACES = {
    "action/SimulateSteps": "f0837c898e1219cd73bf4c041feab41e8c533e8e1057e982744dba7b093467eb",
    "srv/DeleteEntity": "ff7e96a5b83dc8e2bb34b8b034480028b3a24d9f8376b2c0590bac3704be3e28",
    "srv/GetAvailableWorlds": "ce5589b5523f2732d1969a3c5a7e6b17a387091df8190c62f78d7fdd1109e3e3",
    "srv/GetCurrentWorld": "79ed4e910e1b7a1c9f7950ff758bfba3535bf0dec669054e8af115a099724ddd",
    "srv/GetEntities": "cb90004c48cd50f37732fb008e22c34c261dd680a723bf0f85d8437ea4498bf7",
    "srv/GetEntitiesStates": "0a76170d0c1c90e1eaf805cfab78ea801d1f82df309a28c1f0fae4b570f19754",
    "srv/GetEntityInfo": "953b7ab6bfc35063f5c9a72463c6ce489baa10249a7fa510926d342a34b0d29e",
    "srv/GetEntityState": "749c91f2a2353d98367b64f2995a0f5842ce92a08ec1ffb3e185540a91557fb5",
    "srv/GetSimulationState": "3362dcebee4b1afebbf9c4beee5c79c1455385aded62092a892d61fde8644f30",
    "srv/GetSimulatorFeatures": "abb9439c8cf196722a469fb6c68b44b484f198c2a1356ac38849a29c2a20a794",
    "srv/LoadWorld": "87d0ded1bfddb40a74d0bedb963fdd592fbedb14d0057d597850404b73c338af",
    "srv/ResetSimulation": "4ce285d7ff9b8ac70dcc95161f32bf54c05a6f4b13427990e41ab40c36c39646",
    "srv/SetEntityState": "fba636c91d38832dbd4f6896ffce54ff98fd9929962b0533546b56ce00f988ac",
    "srv/SetSimulationState": "a868b916dce49974f637ba252141258c4b07b0c06858b88af560e3eb6bfbcb30",
    "srv/SpawnEntity": "66860313e11009faddbfc8568e5d410d1a11607fe75eeb1308671dc0406fe3a7",
    "srv/StepSimulation": "913fe0653690ce6bf8f09f316e6a626747012e9fca31e26719910d417aa8565c",
}
"""Type hashes of release 2.1.0, made from its own files; those of messages are part of them."""


@pytest.mark.parametrize("name", SIMULATION_INTERFACES)
def test_simulation_interfaces_are_the_official_ones(name: str) -> None:
    file = PREFIX / "share" / "simulation_interfaces" / f"{name}.json"
    definition = json.loads(file.read_text())
    hashes = {entry["type_name"]: entry["hash_string"] for entry in definition["type_hashes"]}
    expected = f"RIHS01_{SIMULATION_INTERFACES[name]}"
    assert hashes[f"simulation_interfaces/{name}"] == expected


@pytest.mark.parametrize("own_runtime_folder", [True, False])
def test_the_environment_s_script_foresees_no_log_folder(
    tmp_path: Path, own_runtime_folder: bool
) -> None:
    """It was the same for everybody, among the temporary files."""
    (tmp_path / "runtime").mkdir(mode=0o700 if own_runtime_folder else 0o755)
    (tmp_path / f"oaisys-ros-log-{os.getuid()}").symlink_to(tmp_path / "victim")
    script = tmp_path / "script.sh"
    script.write_text(_SCRIPT.format(exports="export VIRTUAL_ENV=/nonexistent"))
    told = subprocess.run(
        ["bash", "-euc", f"source {script}; echo $ROS_LOG_DIR"],
        env={
            "PATH": os.environ["PATH"],
            "HOME": "/nonexistent",
            "TMPDIR": str(tmp_path),
            "XDG_RUNTIME_DIR": str(tmp_path / "runtime"),
        },
        capture_output=True,
        text=True,
        check=True,
    )
    folder = Path(told.stdout.strip())
    if own_runtime_folder:
        assert folder.parent == tmp_path / "runtime"
    else:
        assert folder.parent == tmp_path
        assert folder.stat().st_mode & 0o777 == 0o700
    assert folder.name != f"oaisys-ros-log-{os.getuid()}"
