#!/usr/bin/env bash
# The studies of docs/forgetting.md: configs/forgetting.json with one or more settings changed, 40 seeds each.
#   configs/studies/forgetting.sh OUT [NAME …]      without a name: all
# SEEDS=350000..350100 trains more seeds, and CARTPOLE_DQN names another program.
set -euo pipefail
base=$(dirname "$0")/../forgetting.json
program=${CARTPOLE_DQN:-target/release/cartpole-dqn}
out=${1:?a directory for the studies}
shift

falling='optimizer.schedule={"final_learning_rate":0,"steps":40000}'
soft='target={"kind":"soft","tau":0.02}'
settings() { # NAME
    case $1 in
    base) ;;
    falling_rate) echo "$falling" ;;
    small_rate) echo optimizer.learning_rate=0.0005 ;;
    rare_copies) echo target.every_steps=1000 ;;
    soft) echo "$soft" ;;
    policy) printf '%s\n' "$soft" policy_weights=target ;;
    six_steps) echo n_step=6 ;;
    double) echo double=true ;;
    huber) echo loss=huber ;;
    norm) echo optimizer.max_gradient_norm=10 ;;
    batch) echo replay.batch_size=128 ;;
    small_memory) echo replay.capacity=1000 ;;
    large_memory) echo replay.capacity=40000 ;;
    gamma_95) echo gamma=0.95 ;;
    gamma_999) echo gamma=0.999 ;;
    policy_falling) printf '%s\n' "$soft" policy_weights=target "$falling" ;;
    policy_six) printf '%s\n' "$soft" policy_weights=target n_step=6 ;;
    policy_six_falling) printf '%s\n' "$soft" policy_weights=target n_step=6 "$falling" ;;
    policy_six_gamma) printf '%s\n' "$soft" policy_weights=target n_step=6 gamma=0.999 ;;
    policy_six_gamma_memory) printf '%s\n' "$soft" policy_weights=target n_step=6 gamma=0.999 replay.capacity=40000 ;;
    all) printf '%s\n' "$soft" policy_weights=target n_step=6 gamma=0.999 replay.capacity=40000 "$falling" ;;
    limit_as_end) echo truncation_is_terminal=true ;;
    lasting) echo stop_when_lasting_steps=7500 ;;
    *) echo "unknown study $1" >&2 && return 2 ;;
    esac
}
[ $# -gt 0 ] || set -- base falling_rate small_rate rare_copies soft policy six_steps double huber norm batch small_memory \
    large_memory gamma_95 gamma_999 policy_falling policy_six policy_six_falling policy_six_gamma policy_six_gamma_memory all limit_as_end lasting
for name in "$@"; do
    lines=$(settings "$name")
    sets=()
    while read -r setting; do [ -z "$setting" ] || sets+=(--set "$setting"); done <<< "$lines"
    "$program" study --config "$base" "${sets[@]}" --seeds "${SEEDS:-350000..350040}" --out "$out/$name" --quiet
    echo "== $name: ${sets[*]}"
    "$program" report "$out/$name"
done
