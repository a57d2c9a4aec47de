#!/usr/bin/env bash
# tests/kills.sh BINARY [N]: N studies and trainings on a program. At random moments one program, all programs, the process, or
# all of them get SIGTERM or SIGKILL, and the same command is given again until it succeeds. No line may record that, and what
# is left must be what an undisturbed command leaves, to the byte. Needs a C compiler.
set -euo pipefail
binary=$(realpath "${1:?the program}")
count=${2:-20}
example=$(realpath "$(dirname "$0")/../adapters/example.c")
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
cd "$tmp"
fail() { printf 'FAILED: %s\n%s\n' "$*" "$(cat stderr 2>/dev/null)" >&2; exit 1; }

cat >train.json <<'JSON'
{
  "environment": {"command": ["./dock"]}, "observation_divisors": null, "replay": {"mirror": false, "warmup_steps": 50, "batch_size": 8},
  "optimizer": {"schedule": null}, "network": {"hidden": [8]}, "budget": {"steps": 4000},
  "evaluation": {"every_steps": 250, "episodes": 2}, "checkpoint": {"every_steps": 300}
}
JSON
prepare() {
    mkdir "$1"
    cp train.json "$1"
    cc -O2 -ffp-contract=off -o "$1/dock" "$example" -lm
}
study=("$binary" study --quiet --config train.json --vary gamma=0.9,0.99 --seeds 0..2 --jobs 2 --out study)
train=("$binary" train --quiet --config train.json --seed 3 --out run)
report() { "$binary" report study --out report --json >/dev/null; }

prepare whole
cd whole
start=$(date +%s%N)
"${study[@]}"
longest=$((($(date +%s%N) - start) / 1000))
"${train[@]}"
report
sort study/trials/*.jsonl >lines
cd ..

programs() {
    local pid
    for pid in $(pgrep -x dock); do
        [ "$(readlink "/proc/$pid/cwd")" != "$PWD" ] || echo "$pid"
    done
}
declare -A strikes
strike() {
    local process=$1 signal=$2 whom=$3 victims
    case $whom in
        program) victims=$(programs | shuf -n 1) ;;
        programs) victims=$(programs) ;;
        process) victims=$process ;;
        # In any order, as a scheduler does it.
        all) victims=$( (programs; echo "$process") | shuf) ;;
    esac
    # shellcheck disable=SC2086
    [ -z "$victims" ] || kill -s "$signal" $victims 2>/dev/null || true
}
# The exit codes that the process may have after that; 0 if it ended before.
may_end_with() {
    case $2-$1 in
        process-TERM | all-TERM) echo '0 143' ;;
        process-KILL | all-KILL) echo '0 137' ;;
        *) echo '0 1' ;;
    esac
}

whom=(program programs process all)
signals=(TERM KILL)
attempts=0
for ((number = 0; number < count; number++)); do
    rm -rf one
    prepare one
    cd one
    for ((attempt = 0; ; attempt++)); do
        if [ $((number % 2)) -eq 0 ]; then
            command=("${study[@]}")
        elif [ -e run/config.json ]; then
            command=("$binary" train --quiet --resume run --allow-command)
        else
            command=("${train[@]}")
        fi
        "${command[@]}" 2>stderr &
        process=$!
        allowed=0
        # The fifth time nobody disturbs it.
        if [ "$attempt" -lt 4 ]; then
            moment=$(((RANDOM * 32768 + RANDOM) % longest))
            sleep "$((moment / 1000000)).$(printf '%06d' $((moment % 1000000)))"
            target=${whom[RANDOM % 4]} signal=${signals[RANDOM % 2]}
            strike "$process" "$signal" "$target"
            strikes[$target-$signal]=$((${strikes[$target-$signal]:-0} + 1))
            allowed=$(may_end_with "$signal" "$target")
        fi
        status=0
        wait "$process" 2>/dev/null || status=$?
        attempts=$((attempts + 1))
        grep -qw "$status" <<<"$allowed" || fail "number $number, SIG${signal:-} to ${target:-nobody}: exit code $status, not $allowed"
        [ "$status" -ne 0 ] || break
    done
    if [ $((number % 2)) -eq 0 ]; then
        ! grep -h '"error":"' study/trials/*.jsonl || fail "number $number: a line records a circumstance"
        report
        for file in report.json evaluations.csv; do
            cmp "report/$file" "../whole/report/$file" || fail "number $number: another $file"
        done
        # A process that is killed while it writes leaves half a line.
        cat study/trials/*.jsonl | grep '}$' | sort -u | cmp - ../whole/lines || fail "number $number: other trials"
        [ ! -e study/unfinished ] || fail "number $number: dead files in study/unfinished"
    else
        for file in config.json metrics.jsonl checkpoints; do
            diff -r "../whole/run/$file" "run/$file" || fail "number $number: another $file"
        done
    fi
    cd ..
done
for kind in "${!strikes[@]}"; do printf '%s %d, ' "$kind" "${strikes[$kind]}"; done
echo "in $attempts attempts of $count studies and trainings: lines that record a circumstance 0, results that differ 0"
