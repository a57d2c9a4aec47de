#!/usr/bin/env bash
# What watching costs: the default config for 100,000 steps with `--quiet` and with `--live`, in turns, in a terminal of
# 80 x 24 (tmux). Prints wall_seconds of each pair's summaries, and the ratio of their means.
#   benches/live.sh BINARY [PAIRS]
set -euo pipefail
binary=$(realpath "$1")
pairs=${2:-24}
tmp=$(mktemp -d)
terminal() { tmux -u -L "$(basename "$tmp")" -f /dev/null "$@"; }
trap 'terminal kill-server; rm -rf "$tmp"' EXIT
terminal new-session -d -s live -x 80 -y 24 "bash --norc"

train() { # DIR OPTION: one run, until the terminal shows what its end looks like
    local shown="exit=0"
    [ "$2" = --quiet ] || shown='steps/s │ finished'
    terminal send-keys -t live \
        "clear; $binary train $2 --seed 3 --set budget.steps=100000 --set stop_when_lasting_steps=null --out $tmp/$1; echo exit=\$?" Enter
    sleep 0.3
    until terminal capture-pane -p -t live | grep -q "$shown"; do sleep 0.1; done
    [ "$2" = --quiet ] || terminal send-keys -t live q
    sleep 0.3
}
seconds() { grep -o '"wall_seconds": [0-9.]*' "$tmp/$1/summary.json" | cut -d' ' -f2; }

for pair in $(seq "$pairs"); do
    train "quiet$pair" --quiet
    train "live$pair" --live
    echo "$(seconds "quiet$pair") $(seconds "live$pair")"
done | awk '{ print; quiet += $1; live += $2 } END { printf "quiet %.3f s, live %.3f s, live/quiet %.3f\n", quiet / NR, live / NR, live / quiet }'
