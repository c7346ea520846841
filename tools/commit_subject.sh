#!/usr/bin/env bash
# Refuses a commit message whose subject is longer than 72 characters or runs into its body.
set -euo pipefail
if [ $# -ne 1 ] || [ ! -f "$1" ]; then
    echo "usage: tools/commit_subject.sh FILE, with the message of a commit" >&2
    [ "${1-}" = --help ] && exit 0
    exit 2
fi
mapfile -t lines < <(grep -v '^#' "$1")
subject=${lines[0]-}
if [ "${#subject}" -gt 72 ] && [[ "$subject" != "fixup! "* ]]; then
    echo "the subject has ${#subject} characters, at most 72 are allowed: $subject" >&2
    exit 1
fi
if [ -n "${lines[1]-}" ]; then
    echo "an empty line must stand between subject and body" >&2
    exit 1
fi
