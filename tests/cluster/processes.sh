#!/usr/bin/env bash
# tests/cluster/processes.sh BINARY [PROCESSES]: many processes work on one study at once, each third is killed at a random
# moment, and they are started again until all is done, also on a file system without locks and with slow renames. The
# report must be that of one process, byte for byte.
set -euo pipefail
binary=$(realpath "${1:?the program}")
processes=${2:-64}
here=$(realpath "$(dirname "$0")")
tmp=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; rm -rf "$tmp"' EXIT
cd "$tmp"
fail() { printf 'FAILED: %s\n' "$*" >&2; exit 1; }
cc -shared -fPIC -o broken_disk.so "$here/broken_disk.c" -ldl

config=(--set network.hidden=[8] --set replay.warmup_steps=50 --set replay.batch_size=8 --set budget.steps=1000
    --set evaluation.every_steps=250 --set evaluation.episodes=2 --vary gamma=0.9,0.99 --seeds "0..$((processes * 8))")
plan() { "$binary" study "${config[@]}" --out "$1" --plan --quiet; }

# One of the processes: overlapping shards, begun again until its trials are done. Its first life may end early.
worker() {
    local study=$1 number=$2 pid
    "$binary" study "$study" --shard "$((number % (processes / 2)))/$((processes / 2))" --jobs 1 --quiet 2>>"errors-$number" &
    pid=$!
    if [ $((number % 3)) -eq 0 ]; then
        sleep "0.$((RANDOM % 9))"
        kill -KILL "$pid" 2>/dev/null || true
        echo >>killed
    fi
    wait "$pid" 2>/dev/null && return
    until "$binary" study "$study" --shard "$((number % (processes / 2)))/$((processes / 2))" --jobs 1 --quiet 2>>"errors-$number"; do
        grep -q 'error:' "errors-$number" && return 1
    done
}

report() { "$binary" report "$1" --out "$1-report" --json >/dev/null; }
plan one
"$binary" study one --quiet
report one
for study in many broken; do
    [ "$study" = many ] || export LD_PRELOAD=$tmp/broken_disk.so
    # Each process plans too, so that they meet at study.json.
    for ((i = 0; i < 8; i++)); do plan "$study" & done
    wait
    workers=()
    for ((i = 0; i < processes; i++)); do
        worker "$study" "$i" &
        workers+=($!)
    done
    for pid in "${workers[@]}"; do wait "$pid" || fail "a process on $study: $(cat errors-*)"; done
    report "$study"
    unset LD_PRELOAD
    cmp one-report/report.json "$study-report/report.json" || fail "$study: another report"
    cmp one-report/evaluations.csv "$study-report/evaluations.csv" || fail "$study: other evaluations"
    cat "$study"/trials/*.jsonl | grep '}$' | sort -u | cmp - <(sort one/trials/*.jsonl) || fail "$study: other trials"
    files=("$study"/trials/*)
    echo "$study: $processes processes at once, ${#files[@]} files, $(cat "$study"/trials/* | wc -l) lines of $((processes * 16)) trials"
done
echo "killed: $(wc -l <killed); the reports are that of one process"
