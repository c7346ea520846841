#!/usr/bin/env bash
# Runs a program in the project's environment: tools/in_env.sh PROGRAM [ARGUMENT...]; VENV as for make.
set -euo pipefail
script=${VENV:-$(dirname "${BASH_SOURCE[0]}")/../.venv}/oaisys_env.sh
[ -f "$script" ] || { echo "$script is missing: run make setup" >&2; exit 1; }
source "$script"
exec "$@"
