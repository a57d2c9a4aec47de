#!/usr/bin/env bash
# tests/disk.sh BINARY: trains on a disk that fills up, and on one that is read-only. Needs to mount a tmpfs.
set -euo pipefail
binary=$(realpath "${1:?the program}")
config=$(realpath "$(dirname "$0")/../configs/smoke.json")
tmp=$(mktemp -d)
mkdir "$tmp/disk"
if ! mount -t tmpfs -o size=72k tmpfs "$tmp/disk" 2>"$tmp/stderr"; then
    printf '\n*** SKIPPED: full and read-only disk, no tmpfs can be mounted here: %s\n\n' "$(cat "$tmp/stderr")" >&2
    exit 0
fi
trap 'umount "$tmp/disk"; rm -rf "$tmp"' EXIT
cd "$tmp"
fail() { printf 'FAILED: %s\n%s\n' "$*" "$(cat "$tmp/stderr")" >&2; exit 1; }
expect() {
    local code=$1 words=$2 status=0
    shift 2
    "$@" 2>"$tmp/stderr" || status=$?
    [ "$status" -eq "$code" ] || fail "exit code $status, not $code: $*"
    grep -q "$words" "$tmp/stderr" || fail "'$words' is not said by: $*"
}

train=("$binary" train --quiet --config "$config" --set checkpoint.every_steps=100)
"${train[@]}" --out whole
# Full in the middle of the run: at once, with the last good checkpoint and no half file.
expect 1 'No space left.*resume with' "${train[@]}" --out disk/run
"$binary" inspect --checkpoint disk/run/checkpoints/last.safetensors >/dev/null
[ -z "$(find disk -name '*.tmp')" ] || fail 'half a file is left'
[ ! -e disk/run/summary.json ] || fail 'a summary of a run that did not end'
# Full from the start of an attempt: nothing is lost.
expect 1 'No space left' "$binary" train --quiet --resume disk/run
mount -o remount,size=8m "$tmp/disk"
"$binary" train --quiet --resume disk/run
for file in config.json metrics.jsonl checkpoints; do
    diff -r "whole/$file" "disk/run/$file" || fail "$file differs from that of a run that had room"
done
mount -o remount,ro "$tmp/disk"
expect 2 'Read-only file system' "${train[@]}" --out disk/other
expect 2 'Read-only file system' "$binary" train --resume disk/run --set budget.steps=3000
"$binary" verify --quiet disk/run
echo 'full disk: stopped, nothing lost, resumed to the same bytes; read-only disk: refused, and verified'
