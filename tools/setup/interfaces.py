"""ROS interfaces that no wheel contains: built once, then copied from the user's cache."""

from __future__ import annotations

import contextlib
import io
import os
import platform
import re
import shutil
import sys
import tarfile
from pathlib import Path

from tools.setup.cache import cache_folder, read_entry, write_entry
from tools.setup.environment import (
    INTERPRETER,
    OAISYS_MSGS,
    REQUIREMENTS,
    SETUP,
    UNDERLAY,
    Environment,
    process_environment,
)
from tools.setup.errors import SetupError
from tools.setup.programs import ProgramProgress, Programs
from tools.setup.relocation import replace_file
from tools.setup.steps import digest

_CMAKE = SETUP / "cmake"
_PLACEHOLDER = b"@OAISYS_PREFIX@"
"""Stands for the environment's path in the text files of an archive."""
_COMPILER_VARIABLES = ("CC", "CXX", "CFLAGS", "CXXFLAGS", "LDFLAGS")


def install_interfaces(environment: Environment, programs: Programs) -> None:
    """Install ``oaisys_msgs`` and the packages of the underlay that the wheels lack.

    Raises:
        SetupError: They had to be built, and that failed; its output was shown.
    """
    sources = [OAISYS_MSGS, *(path for path in UNDERLAY if not _from_wheel(environment, path.name))]
    key = _key(sources)
    folder = cache_folder()
    archive = read_entry(folder, key) if folder is not None else None
    if archive is None:
        stage = _build(environment, programs, sources)
        archive = pack(stage, environment.root)
        shutil.rmtree(stage)
        if folder is not None:
            write_entry(folder, key, archive)
    unpack(archive, environment.root, environment.state / "interfaces.txt")


def _from_wheel(environment: Environment, package: str) -> bool:
    share = environment.root / "share"
    built_here = (share / "colcon-core" / "packages" / package).is_file()
    return (share / package / "package.xml").is_file() and not built_here


def _key(sources: list[Path]) -> str:
    """Return the hash of everything that built interfaces depend on."""
    machine = f"{platform.machine()} {platform.libc_ver()}"
    variables = " ".join(f"{name}={os.environ.get(name, '')}" for name in _COMPILER_VARIABLES)
    code = (Path(__file__), _CMAKE)
    return digest(REQUIREMENTS, INTERPRETER, machine, variables, *code, *sources)


def _build(environment: Environment, programs: Programs, sources: list[Path]) -> Path:
    """Build the packages; return the folder with what they install."""
    build, stage, log = (environment.state / name for name in ("build", "stage", "log"))
    for folder in (build, stage, log):
        shutil.rmtree(folder, ignore_errors=True)
    python = environment.python
    command: list[str | Path] = [environment.root / "bin" / "colcon"]
    command += ["--log-base", log, "build", "--merge-install"]
    command += ["--build-base", build, "--install-base", stage]
    command += ["--base-paths", *sources, "--parallel-workers", str(len(sources))]
    command += ["--event-handlers", "console_cohesion-", "console_package_list-"]
    # No interface is used often enough for optimised code to pay for its compilation.
    command += ["--cmake-args", "-DCMAKE_BUILD_TYPE=Release", "-DBUILD_TESTING=OFF", "-Wno-dev"]
    command += ["-DCMAKE_C_FLAGS_RELEASE=-O0", "-DCMAKE_CXX_FLAGS_RELEASE=-O0"]
    command += ["-DCMAKE_UNITY_BUILD=ON", "-DCMAKE_UNITY_BUILD_BATCH_SIZE=16"]
    command += [f"-DCMAKE_MODULE_PATH={_CMAKE}", f"-Drosidl_default_generators_DIR={_CMAKE}"]
    command += [f"-DPython3_EXECUTABLE={python}", f"-DPYTHON_EXECUTABLE={python}"]
    output = environment.state / "colcon.log"
    code = programs.run(
        command,
        process_environment(environment),
        output,
        lambda said: colcon_progress(said, len(sources), log / "latest_build"),
    )
    if code:
        sys.stderr.write(output.read_text(errors="replace"))
        raise SetupError("building the ROS interfaces failed")
    shutil.rmtree(build)
    return stage


def colcon_progress(output: str, wanted: int, logs: Path) -> ProgramProgress:
    """Return the progress of colcon, from its output and from CMake's in ``logs``."""
    built = output.count("Finished <<<")
    percents = [
        int(found[-1])
        for file in logs.glob("*/stdout.log")
        if (found := re.findall(r"^\[ *(\d+)%\]", file.read_text(errors="replace"), re.MULTILINE))
    ]
    share = sum(percents) / 100 / wanted
    return ProgramProgress(
        f"{built} of {wanted} packages built, {100 * share:.0f} % compiled", share
    )


def pack(stage: Path, prefix: Path) -> bytes:
    """Return the files in ``stage`` as an archive that fits any environment.

    Args:
        stage: Folder with installed packages.
        prefix: The environment with which they were built.
    """
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as tar:
        for file in sorted(stage.rglob("*")):
            if not file.is_file() or file.suffix == ".pyc":
                continue
            content = file.read_bytes()
            if b"\0" not in content:
                for path in (stage, prefix):
                    content = content.replace(bytes(path), _PLACEHOLDER)
            member = tarfile.TarInfo(str(file.relative_to(stage)))
            member.size = len(content)
            member.mode = file.stat().st_mode & 0o777
            tar.addfile(member, io.BytesIO(content))
    return archive.getvalue()


def _remove(name: Path, prefix: Path) -> None:
    """Remove a file and the folders that it leaves empty: pip warns of empty ``egg-info``."""
    (prefix / name).unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # raised by the first that is not empty
        for folder in list(name.parents)[:-1]:
            (prefix / folder).rmdir()


def unpack(archive: bytes, prefix: Path, names_file: Path) -> None:
    """Put the files of an archive into an environment, in the place of those of the last one.

    Args:
        archive: What `pack` returned.
        prefix: The environment.
        names_file: Has the names of the files, for the next time.
    """
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        members = tar.getmembers()
        names = {member.name for member in members}
        old_names = set(names_file.read_text().splitlines()) if names_file.is_file() else set()
        names_file.write_text("\n".join(sorted(names | old_names)))
        for name in old_names - names:
            _remove(Path(name), prefix)
        for member in members:
            content = tar.extractfile(member)
            if content is None:
                continue
            target = prefix / member.name
            target.parent.mkdir(parents=True, exist_ok=True)
            text = content.read().replace(_PLACEHOLDER, bytes(prefix))
            replace_file(target, text, member.mode)
        names_file.write_text("\n".join(sorted(names)))
