"""uv and pip: Python packages are installed with uv, and with pip where uv fails."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tools.setup.checks import existing_folder
from tools.setup.environment import Environment, process_environment
from tools.setup.errors import SetupError
from tools.setup.programs import ProgramProgress, Programs

CACHE_GB = 4.0
"""What the pinned packages take in uv's cache."""

_PIP_OPTIONS = (
    *("--no-deps", "--no-input", "--progress-bar=off"),
    *("--disable-pip-version-check", "--no-warn-script-location"),
)
_UV_OPTIONS = (
    *("--no-deps", "--color=never"),
    # Symbolic links would leave an environment that breaks when the cache is cleaned.
    "--link-mode=hardlink",
    # pip, too, takes a version from whichever index has it.
    "--index-strategy=unsafe-best-match",
)

_MEGABYTES = {"K": 0.001024, "M": 1.048576, "G": 1073.741824}


@dataclass(frozen=True)
class UvCache:
    """uv's cache.

    Attributes:
        folder: It exists and is writable.
        linked: Whether files in it can be linked into the environment and take no space there.
    """

    folder: Path
    linked: bool


@dataclass(frozen=True)
class IndexSettings:
    """Where packages come from: options of uv, and environment variables for it."""

    options: tuple[str, ...] = ()
    variables: Mapping[str, str] = field(default_factory=dict)


def uv_settings(pip_config: str) -> IndexSettings:
    """Translate pip's configuration, which uv does not read.

    Args:
        pip_config: Output of ``pip config list``.
    """
    values: dict[str, str] = {}
    for section in ("global", "install", ":env:"):  # pip takes the last of them
        for name, text in re.findall(rf"^{section}\.([\w-]+)=(.+)$", pip_config, re.MULTILINE):
            values[name] = str(ast.literal_eval(text))
    options = [f"--index-url={url}" for url in values.get("index-url", "").split()]
    for name, option in (
        ("extra-index-url", "extra-index-url"),
        ("find-links", "find-links"),
        ("trusted-host", "allow-insecure-host"),
    ):
        options += [f"--{option}={value}" for value in values.get(name, "").split()]
    if values.get("no-index", "").lower() in ("1", "true", "yes", "on"):
        options.append("--no-index")
    # pip trusts the certificates of the system, uv a list of its own.
    variables = {"UV_SYSTEM_CERTS": "true"}
    if "cert" in values:
        variables["SSL_CERT_FILE"] = values["cert"]
    if "proxy" in values:
        variables["ALL_PROXY"] = values["proxy"]
    return IndexSettings(tuple(options), variables)


def uv_cache(root: Path, environment_gb: float) -> UvCache | None:
    """Return uv's cache, or None if it cannot be used.

    It must be writable. Where its files cannot be linked into the environment they are copied, and
    its disk must have room for them: beside the environment, if that is on the same one.

    Args:
        root: The environment's folder, which need not exist.
        environment_gb: What the environment itself will need.
    """
    base = os.environ.get("XDG_CACHE_HOME")
    chosen = os.environ.get("UV_CACHE_DIR")
    try:
        cache = Path(chosen) if chosen else (Path(base) if base else Path.home() / ".cache") / "uv"
        cache.mkdir(parents=True, exist_ok=True)
        beside = existing_folder(root)
        with tempfile.NamedTemporaryFile(dir=cache, prefix=".oaisys-") as file:
            if _can_link(Path(file.name), beside):
                return UvCache(cache, linked=True)
        same_disk = cache.stat().st_dev == beside.stat().st_dev
        needed_gb = CACHE_GB + (environment_gb if same_disk else 0.0)
        free_gb = shutil.disk_usage(cache).free / 1e9
    except (OSError, RuntimeError):
        return None
    return UvCache(cache, linked=False) if free_gb >= needed_gb else None


def _can_link(file: Path, folder: Path) -> bool:
    link = folder / file.name
    try:
        link.hardlink_to(file)
    except OSError:
        return False
    link.unlink()
    return True


@dataclass(frozen=True)
class Installer:
    """Installs packages into an environment.

    Attributes:
        environment: It has pip already.
        programs: Run pip and uv.
        cache: uv's cache; None if uv is to work without one.
    """

    environment: Environment
    programs: Programs
    cache: UvCache | None

    @property
    def uv(self) -> Path:
        """The program of uv."""
        return self.environment.root / "bin" / "uv"

    @property
    def uv_log(self) -> Path:
        """The file with uv's output."""
        return self.environment.state / "uv.log"

    def with_uv(self, wanted: int, *arguments: str) -> bool:
        """Install with uv; return False, and say why, if that failed."""
        settings = uv_settings(self._pip_config())
        command = [str(self.uv), "pip", "install", *_UV_OPTIONS, *settings.options]
        command += ["--python", str(self.environment.python), *arguments]
        if self.cache is None:
            command.append("--no-cache")
        else:
            command += ["--cache-dir", str(self.cache.folder)]
        log = self.uv_log
        try:
            succeeded = self._run(command, settings.variables, log, wanted, uv_progress) == 0
        except OSError as error:
            log.write_text(f"{error}\n")
            succeeded = False
        if not succeeded:
            self.programs.display.say(f"uv failed, its output is in {log}; installing with pip")
        return succeeded

    def bring_uv(self, version: str) -> bool:
        """Install uv with pip; return False, and say why, if that failed."""
        log = self.uv_log
        command = [*self._pip_command(), f"uv=={version}"]
        if self._run(command, {}, log, 1, pip_progress):
            self.programs.display.say(
                f"pip cannot install uv, its output is in {log}; installing with pip"
            )
            return False
        return True

    def with_pip(self, wanted: int, *arguments: str) -> None:
        """Install with pip.

        Raises:
            SetupError: It failed; the end of its output was shown.
        """
        log = self.environment.state / "pip.log"
        if self._run([*self._pip_command(), *arguments], {}, log, wanted, pip_progress):
            # Omit lines about collected packages and unreachable indices.
            usual = ("WARNING", "Collecting", "Requirement already", "  Using", "  Downloading")
            errors = [line for line in log.read_text().splitlines() if not line.startswith(usual)]
            sys.stderr.write(os.linesep.join(errors[-40:]) + os.linesep)
            raise SetupError(f"pip failed; its whole output is in {log}")

    def _run(
        self,
        command: list[str],
        variables: Mapping[str, str],
        log: Path,
        wanted: int,
        progress: Callable[[str, int, Path], ProgramProgress],
    ) -> int:
        # /tmp may be in memory, so unpack the wheels on the disk of the environment.
        temporary = self.environment.state / "tmp"
        temporary.mkdir(parents=True, exist_ok=True)
        site_packages = self.environment.site_packages
        try:
            return self.programs.run(
                command,
                {**process_environment(self.environment), **variables, "TMPDIR": str(temporary)},
                log,
                lambda said: progress(said, wanted, site_packages),
            )
        finally:
            shutil.rmtree(temporary, ignore_errors=True)

    def _pip_command(self) -> list[str]:
        return [str(self.environment.python), "-P", "-m", "pip", "install", *_PIP_OPTIONS]

    def _pip_config(self) -> str:
        return subprocess.run(
            [self.environment.python, "-P", "-m", "pip", "config", "list"],
            env=process_environment(self.environment),
            capture_output=True,
            text=True,
            check=False,
        ).stdout


def pip_progress(output: str, wanted: int, site_packages: Path) -> ProgramProgress:
    """Return the progress of pip, from its output and the installed packages."""
    lines = output.splitlines()
    if any(line.startswith("Installing collected packages") for line in lines):
        return _find_progress(wanted, site_packages)
    starts = ("Collecting ", "Requirement already satisfied", "Obtaining ")
    collected = min(sum(line.startswith(starts) for line in lines), wanted)
    return ProgramProgress(f"{collected} of {wanted} packages collected", 0.5 * collected / wanted)


def uv_progress(output: str, wanted: int, site_packages: Path) -> ProgramProgress:
    """Return the progress of uv, from its output and the installed packages."""
    if re.search(r"^Prepared ", output, re.MULTILINE):
        return _find_progress(wanted, site_packages)
    sizes = re.findall(r"^Downloading (\S+) \(([\d.]+)([KMG])iB\)", output, re.MULTILINE)
    size_mb = {name: float(size) * _MEGABYTES[unit] for name, size, unit in sizes}
    arrived = re.findall(r"^ Downloaded (\S+)", output, re.MULTILINE)
    total_mb = sum(size_mb.values())
    done_mb = sum(size_mb.get(name, 0.0) for name in arrived)
    if total_mb == 0.0:
        return ProgramProgress(f"{wanted} packages being prepared", 0.0)
    return ProgramProgress(
        f"{done_mb:.0f} of {total_mb:.0f} MB downloaded", 0.5 * done_mb / total_mb
    )


def _find_progress(wanted: int, site_packages: Path) -> ProgramProgress:
    count = sum(1 for _ in site_packages.glob("*.dist-info"))  # pip itself among them
    installed = min(count, wanted)
    return ProgramProgress(
        f"{installed} of {wanted} packages installed", 0.5 + 0.5 * installed / wanted
    )
