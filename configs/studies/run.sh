#!/usr/bin/env bash
# The tutorial's claims, each a study of 100 seeds on base.json: the tutorial's settings with minibatch updates, time
# limits handled as truncation, and 20,000 environment steps. `mirror_plain` is a study of plain.json beside it.
#   configs/studies/run.sh OUT [NAME …]      without a name: all
set -euo pipefail
base=$(dirname "$0")/base.json
program=${CARTPOLE_DQN:-target/release/cartpole-dqn}
out=${1:?a directory for the studies}
shift

study() { # NAME VARY…
    local name=$1 vary=()
    shift
    for variation in "$@"; do vary+=(--vary "$variation"); done
    "$program" study --config "$base" "${vary[@]}" --seeds 0..100 --out "$out/$name" --quiet
    "$program" report "$out/$name"
}
run() {
    case $1 in
    target_and_replay)
        study "$1" 'target=[{"kind":"hard","every_episodes":10},{"kind":"none"}]' \
            'replay=[{"capacity":2000,"batch_size":32},{"capacity":1,"batch_size":1}]' ;;
    double) study "$1" double=false,true ;;
    loss) study "$1" loss=mse,huber ;;
    gamma) study "$1" gamma=0.95,0.99 ;;
    truncation) study "$1" truncation_is_terminal=true,false ;;
    per_sample) study "$1" replay.update=per_sample,minibatch ;;
    mirror) study "$1" replay.mirror=false,true ;;
    mirror_plain) base=$(dirname "$0")/plain.json study "$1" replay.mirror=false,true ;;
    epsilon_decay) study "$1" exploration.decay=0.98,0.99,0.995,0.998 ;;
    *) echo "unknown study $1" >&2 && exit 2 ;;
    esac
}
[ $# -gt 0 ] || set -- target_and_replay double loss gamma truncation per_sample epsilon_decay mirror mirror_plain
for name in "$@"; do run "$name"; done
