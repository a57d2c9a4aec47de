#!/usr/bin/env bash
# tests/refusals.sh BINARY [N]: N refused commands against a running training, which must end with the bytes of an
# undisturbed one; then N/4 pairs of trainings that start together in one directory, of which exactly one must win.
set -euo pipefail
binary=$(realpath "${1:?the program}")
count=${2:-200}
config=$(realpath "$(dirname "$0")/../configs/smoke.json")
tmp=$(mktemp -d)
training=
trap '[ -z "$training" ] || kill "$training" 2>/dev/null || true; rm -rf "$tmp"' EXIT
cd "$tmp"
fail() { printf 'FAILED: %s\n%s\n' "$*" "$(cat "$tmp/stderr" 2>/dev/null)" >&2; exit 1; }
same() {
    for file in config.json metrics.jsonl checkpoints; do
        diff -rq "$1/$file" "$2/$file" || fail "$2/$file differs from that of an undisturbed run"
    done
}
# Ends only when it is told to; then as far as it came is trained again without any disturbance.
train=("$binary" train --quiet --config "$config" --set evaluation.every_steps=900000 --set checkpoint.every_steps=900000)
"${train[@]}" --out run --set budget.steps=1000000000 2>training &
training=$!
until [ -s run/metrics.jsonl ]; do sleep 0.01; done
for ((i = 0; i < count; i++)); do
    case $((i % 7)) in
        0) command=("${train[@]}" --out run) ;;
        1) command=("${train[@]}" --out run --force) ;;
        2) command=("$binary" train --resume run) ;;
        3) command=("$binary" study --seeds 0..2 --out run) ;;
        4) command=("$binary" verify run) ;;
        5) command=("$binary" report run --html run/config.json) ;;
        6) command=("$binary" report run --out run/config.json) ;;
    esac
    status=0
    "${command[@]}" >stdout 2>stderr || status=$?
    [ "$status" -eq 2 ] || fail "exit code $status, not 2: ${command[*]}"
    kill -0 "$training" 2>/dev/null || fail "the training has ended after: ${command[*]}"
done
kill -TERM "$training"
status=0
wait "$training" || status=$?
training=
[ "$status" -eq 143 ] || fail "the training ended with exit code $status"
steps=$(sed -n 's/.*stopped after step \([0-9]*\).*/\1/p' training)
"$binary" train --quiet --resume run --set budget.steps=$((steps + 100)) 2>stderr || fail 'the run cannot be resumed'
"${train[@]}" --out whole --set budget.steps=$((steps + 100))
same whole run

race=("$binary" train --quiet --config "$config")
"${race[@]}" --out undisturbed
for ((i = 0; i < count / 4; i++)); do
    rm -rf race
    "${race[@]}" --out race 2>stderr1 & first=$!
    "${race[@]}" --out race 2>stderr2 & second=$!
    a=0 b=0
    wait "$first" || a=$?
    wait "$second" || b=$?
    [ $((a + b)) -eq 2 ] && [ $((a * b)) -eq 0 ] || fail "two trainings started together: exit codes $a and $b"
    same undisturbed race
done
echo "refused commands $count, races of two trainings $((count / 4)), trainings lost or different 0"
