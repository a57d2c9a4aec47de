#!/usr/bin/env bash
# Runs `watch` and `train --live` in tmux: what they show, how they end, and that the terminal is usable afterwards.
# Usage: tests/terminal.sh BINARY CHECKPOINT
set -euo pipefail
binary=$(realpath "$1") checkpoint=$(realpath "$2")
smoke=$(realpath "$(dirname "$0")/../configs/smoke.json")
tmp=$(mktemp -d)
export LC_ALL=C.UTF-8

mux() { tmux -u -L "cartpole-dqn-$$" -f /dev/null "$@"; }
trap 'mux kill-server 2>/dev/null || true; rm -rf "$tmp"' EXIT

press() { mux send-keys -t view "$@"; }
# Waits until a line of the screen matches.
shows() {
    for _ in $(seq 200); do
        if mux capture-pane -p -t view | grep -q -- "$1"; then return; fi
        sleep 0.1
    done
    printf 'FAILED: no "%s" in\n' "$1" >&2
    mux capture-pane -p -t view >&2
    exit 1
}
run() { press "clear; sh -c 'echo \$\$ >pid; exec \"\$@\"' sh $binary $*; echo code=\$?" Enter; }
# The exit code, and a shell that echoes what is typed.
ended() {
    shows "^code=$1\$"
    press "echo us''able" Enter
    shows "echo us''able"
    shows '^usable$'
}
# Waits until the shell knows it.
resize() {
    mux resize-window -t view -x "$1" -y "$2"
    press "clear; until [ \"\$(stty size)\" = '$2 $1' ]; do sleep 0.1; done; echo re''sized" Enter
    shows '^resized$'
}

mux new-session -d -s view -x 80 -y 24 -c "$tmp" 'PS1="$ " bash --norc'

run watch --checkpoint "$checkpoint"
shows 'step [1-9][0-9]* of 500 .* plays'
shows '◆ chosen'
press Space
shows 'paused'
press Right
shows 'pushed ►'
mux resize-window -t view -x 40 -y 15
shows 'at least 70 × 20'
mux resize-window -t view -x 80 -y 24
shows 'pushed ►'
press q
ended 0

run watch --checkpoint "$checkpoint"
shows 'plays'
kill -TERM "$(cat "$tmp/pid")"
ended 143

run train --live --pace 100x --out stopped
shows 'latest policy'
press q
shows 'stopped after step'
ended 130
test -f "$tmp/stopped/checkpoints/last.safetensors"

run train --live --config "$smoke" --out finished
shows 'steps/s │ finished'
press q
shows '^trained '
ended 0

resize 60 24
run train --live --out refused
shows '60 × 24'
ended 2
test ! -e "$tmp/refused"
# A terminal that goes away takes its view along.
resize 80 24
run watch --checkpoint "$checkpoint"
shows 'plays'
mux kill-server
for _ in $(seq 50); do
    if ! kill -0 "$(cat "$tmp/pid")" 2>/dev/null; then
        echo 'the terminal views work'
        exit
    fi
    sleep 0.1
done
echo 'FAILED: watch outlives its terminal' >&2
exit 1
