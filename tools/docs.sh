#!/usr/bin/env bash
# Gathers the pages of the site and runs mkdocs on them, in an environment of its own.
#   tools/docs.sh FOLDER COMMAND [ARGUMENT ...]    FOLDER holds mkdocs, which is put there at first
# The project's environment must be on PATH, as after `source .venv/oaisys_env.sh`.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

folder=$1
shift
pins=requirements/docs.txt
if ! cmp -s "$pins" "$folder/installed.txt"; then
    "$(command -v python)" -m venv --clear "$folder"
    "$folder/bin/python" -m pip install --quiet --no-deps --disable-pip-version-check --requirement "$pins"
    cp "$pins" "$folder/installed.txt"
fi
python -m tools.docs out/docs/source
# The builder's notice about its successors is not a fault of a page.
NO_MKDOCS_2_WARNING=1 "$folder/bin/python" -m mkdocs "$@"
