#!/usr/bin/env bash
# tests/soak.sh BINARY [RUNS]: trains runs that are killed with SIGKILL at random moments and resumed until they end.
# Each must leave what the run that nobody killed leaves, to the byte. Prints the figures; fails if one run is lost.
set -euo pipefail
binary=$(realpath "${1:?the program}")
runs=${2:-10}
config=$(realpath "$(dirname "$0")/../configs/smoke.json")
# In memory where that is possible: what a killed process has written is there without fsync, which is slow on a busy disk.
tmp=$([ -w /dev/shm ] && mktemp -d -p /dev/shm || mktemp -d)
trap 'rm -rf "$tmp"' EXIT
cd "$tmp"

train=("$binary" train --quiet --config "$config" --set budget.steps=6000 --set evaluation.every_steps=700
    --set checkpoint.every_steps=150 --set 'target={"kind":"soft"}' --set n_step=3)
start=$(date +%s%N)
for seed in 0 1 2 3 4; do "${train[@]}" --seed "$seed" --out "whole$seed"; done
# Kills fall into the first half of an attempt's time, so that a run takes several.
longest=$(( ($(date +%s%N) - start) / 5 / 1000 / 2 ))

kills=0 resumes=0 fallbacks=0
for ((run = 0; run < runs; run++)); do
    seed=$((run % 5))
    rm -rf killed
    while true; do
        if [ -e killed/config.json ]; then
            resumes=$((resumes + 1))
            "$binary" train --quiet --resume killed 2>stderr &
        else
            "${train[@]}" --seed "$seed" --out killed 2>stderr &
        fi
        pid=$!
        sleep "$(printf '0.%06d' $(( (RANDOM * 32768 + RANDOM) % (longest < 999999 ? longest : 999999) )))"
        kill -KILL "$pid" 2>/dev/null || true
        status=0
        wait "$pid" 2>/dev/null || status=$?
        if grep -q 'resuming from' stderr; then fallbacks=$((fallbacks + 1)); fi
        case $status in
            0) break ;;
            137) kills=$((kills + 1)) ;;
            *) printf 'FAILED: run %d, after %d kills: exit code %d: %s\n' "$run" "$kills" "$status" "$(cat stderr)" >&2
               exit 1 ;;
        esac
    done
    for file in config.json metrics.jsonl checkpoints; do
        diff -rq "whole$seed/$file" "killed/$file" || { echo "FAILED: run $run differs" >&2; exit 1; }
    done
done
echo "runs $runs, kills $kills, resumes $resumes, checkpoints found damaged or missing $fallbacks, runs lost or different 0"
