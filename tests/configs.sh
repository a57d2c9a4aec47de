#!/usr/bin/env bash
# Trains every shipped config that needs no program over its whole budget, and compares the weights with the recorded ones.
#   tests/configs.sh BINARY
set -euo pipefail
binary=$(realpath "$1")
cd "$(dirname "$0")/.."
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT

recorded() { # CONFIG: the hash in tests/data/config_weights.json
    sed -n "\|\"$1\": {|,/}/s/.*\"whole budget\": \"\([0-9a-f]*\)\".*/\1/p" tests/data/config_weights.json
}
(cd configs && find . -name '*.json' -printf '%P\n' | sort) >"$out/configs"
while read -r config; do
    grep -q '"command"' "configs/$config" && { echo "$config: skipped, its environment is a program"; continue; }
    "$binary" train --config "configs/$config" --quiet --out "$out/run" </dev/null >/dev/null
    grep -q "\"weights_sha256\": \"$(recorded "$config")\"" "$out/run/summary.json" ||
        { echo "$config: not the recorded weights"; exit 1; }
    echo "$config: the recorded weights"
    rm -rf "$out/run"
done <"$out/configs"
