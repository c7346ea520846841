#!/usr/bin/env bash
# Checks the gRPC contract with buf: its style, and that it breaks no client of the released one.
#   tools/buf.sh FOLDER            checks; FOLDER holds buf, which npm installs there at first
#   tools/buf.sh FOLDER release    makes today's contract the released one, for `make contract`
# Without npm, or where its registry is out of reach, the check is left out, and says so.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

version=1.75.0
folder=$1
buf=$folder/node_modules/.bin/buf

without() {
    echo "lint: the gRPC contract was not checked: $1" >&2
    [ "${2:-check}" = check ] && exit 0
    exit 1
}

if [ "$("$buf" --version 2>/dev/null)" != "$version" ]; then
    command -v npm >/dev/null || without "buf needs npm to be installed" "${2:-}"
    mkdir -p "$folder"
    if ! npm install --prefix "$folder" --silent --no-save --no-audit --no-fund --ignore-scripts \
        "@bufbuild/buf@$version" >"$folder/install.log" 2>&1; then
        without "npm could not install buf: $folder/install.log" "${2:-}"
    fi
fi

cd oaisys_grpc
if [ "${2:-check}" = release ]; then
    "$buf" build --exclude-source-info -o released.json
else
    "$buf" lint
    "$buf" breaking --against released.json
fi
