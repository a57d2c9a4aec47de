#!/usr/bin/env bash
# Instructions of one training step at 4-24-24-2, batch 32, by valgrind's callgrind, which counts and does not measure
# time. It knows no AVX-512, so the AVX2 path is counted. Fails if a count is more than 3 % above the recorded one.
#   benches/instructions.sh [--record]
set -euo pipefail
cd "$(dirname "$0")/.."
recorded=benches/instructions.txt
program=$(cargo bench --bench instructions --no-run --message-format=json 2>/dev/null |
    grep -o '"executable":"[^"]*instructions-[^"]*"' | cut -d'"' -f4)

count() { # STEPS EVERY: instructions of the process
    local out
    out=$(mktemp)
    CARTPOLE_DQN_SIMD=avx2 valgrind --tool=callgrind --callgrind-out-file="$out" "$program" "$@" >/dev/null 2>&1
    awk '/^summary:/ { print $2 }' "$out"
    rm -f "$out"
}
per_step() { # NAME EVERY
    echo "$1 $((($(count 1500 "$2") - $(count 500 "$2")) / 1000))"
}
counts=$(per_step step_with_update 1; per_step step_without_update 1000000000)
echo "$counts"
if [ "${1:-}" = --record ]; then
    echo "$counts" >"$recorded"
    exit
fi
awk 'NR == FNR { limit[$1] = $2 * 1.03; next }
     !($1 in limit) || $2 > limit[$1] { print "more instructions than recorded:", $0; failed = 1 }
     END { exit failed }' "$recorded" <(echo "$counts")
