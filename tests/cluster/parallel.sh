#!/usr/bin/env bash
# tests/cluster/parallel.sh BINARY: a study by GNU parallel; the report must be that of one process.
set -euo pipefail
binary=$(realpath "${1:?the program}")
script=$(realpath "$(dirname "$0")/../../scripts/cluster/parallel.sh")
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
cd "$tmp"
for study in many one; do "$binary" study --set budget.steps=2000 --seeds 0..24 --out "$study" --plan --quiet; done
# The first call is told to stop early, as an engine would before a time limit, and the second runs what is left.
status=0
CARTPOLE_DQN=$binary "$script" many 4 --jobs 2 --timeout 1 2>/dev/null || status=$?
CARTPOLE_DQN=$binary "$script" many 4 --jobs 2
"$binary" study one --quiet
for study in many one; do "$binary" report "$study" --out "$study-report" --json >/dev/null; done
cmp one-report/report.json many-report/report.json
echo "GNU parallel: 4 shards, exit code $status of the call that was stopped early; the report is that of one process"
