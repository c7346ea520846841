#!/usr/bin/env bash
# Finds an interpreter that can run the Blender worker and hands over to tools/setup.
# VENV: the virtual environment's folder. PYTHON: the interpreter to use, nothing else is tried.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

# A sourced ROS install or another environment must not leak into this one.
unset PYTHONPATH PYTHONHOME LD_LIBRARY_PATH AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH
unset VIRTUAL_ENV _ROS_WHEELS_BOOTSTRAP_COMPLETE PYTHONDONTWRITEBYTECODE

venv=${VENV:-.venv}
rejected=()

# Prints why the interpreter $1 cannot be used; prints nothing where it can.
fault_of() {
    local probe='
import pathlib, sys, sysconfig
version = "%d.%d" % sys.version_info[:2]
if version not in ("3.11", "3.13"):
    sys.exit(f"is {version}")
try:
    import venv
    from ensurepip import version as _
except ImportError:
    sys.exit(f"has no venv module: apt install python{version}-venv")
if not pathlib.Path(sysconfig.get_path("include"), "Python.h").is_file():
    sys.exit(f"has no Python.h: apt install python{version}-dev")
'
    local answer
    if answer=$("$1" -c "$probe" 2>&1); then return; fi
    case $answer in
        "is 3."* | "has no "*) echo "$answer" ;;
        *) echo "does not run" ;;
    esac
}

try() {
    local fault
    fault=$(fault_of "$1")
    if [ -z "$fault" ]; then
        exec "$1" -m tools.setup --venv "$venv"
    fi
    rejected+=("$1 $fault")
}

if [ -n "${PYTHON:-}" ]; then
    try "$PYTHON"
    echo "setup: PYTHON must be a usable CPython 3.11 or 3.13: ${rejected[0]}" >&2
    exit 1
fi

# An environment that exists keeps its interpreter, whatever PATH says today.
if [ -x "$venv/bin/python" ] && base=$("$venv/bin/python" -I -S -c 'import sys; print(sys._base_executable)'); then
    try "$base"
fi

while read -r candidate; do
    try "$candidate"
done < <(type -aP python3 python3.13 python3.11 || true)

if command -v uv >/dev/null; then
    if candidate=$(uv python find --system --no-project 3.13 2>/dev/null) ||
        { uv python install 3.13 && candidate=$(uv python find --system --no-project 3.13); }; then
        try "$candidate"
    else
        rejected+=("uv could not bring one")
    fi
fi

faults=$(printf '%s, ' "${rejected[@]:-nothing called python3 on PATH}")
echo "setup: no usable CPython 3.11 or 3.13: ${faults%, };" \
    "install one with its venv and dev packages, or uv" >&2
exit 1
