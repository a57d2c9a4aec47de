#!/usr/bin/env bash
# Runs `watch` and `train --live` in tmux and GNU screen: what they show, how they end, and that the terminal is usable afterwards.
# Usage: tests/terminal.sh BINARY CHECKPOINT
set -euo pipefail
binary=$(realpath "$1") checkpoint=$(realpath "$2")
smoke=$(realpath "$(dirname "$0")/../configs/smoke.json")
tmp=$(mktemp -d)
export LC_ALL=C.UTF-8

mux() { tmux -u -L "cartpole-dqn-$$" -f /dev/null "$@"; }
screens() { SCREENDIR=$tmp/screen screen "$@"; }
end() {
    mux kill-server 2>/dev/null || true
    if [ -d "$tmp/screen" ]; then screens -S view -X quit >/dev/null 2>&1 || true; fi
    rm -rf "$tmp"
}
trap end EXIT

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
# Waits until no line does.
shows_not() {
    for _ in $(seq 200); do
        if ! mux capture-pane -p -t view | grep -q -- "$1"; then return; fi
        sleep 0.1
    done
    printf 'FAILED: "%s" stays in\n' "$1" >&2
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
shows 'yours: right'
mux resize-window -t view -x 40 -y 15
shows 'at least 70 × 20'
mux resize-window -t view -x 2 -y 2
mux resize-window -t view -x 80 -y 24
shows 'yours: right'
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

# A step that takes hours: who quits again gets the terminal back at once, and so does a second signal.
slow=(--live --config "$smoke" --set learn.updates=4000000000 --set replay.warmup_steps=64)
run train "${slow[*]}" --out slow-q
shows 'step [1-9][0-9]* of'
sleep 1
press q
shows 'q again ends at once'
sleep 1.2
press q
ended 130
shows_not 'learning curve'

run train "${slow[*]}" --out slow-c
shows 'step [1-9][0-9]* of'
sleep 1
press C-c
shows 'q again ends at once'
sleep 1.2
press C-c
ended 130

run train "${slow[*]}" --out slow-term
shows 'step [1-9][0-9]* of'
sleep 1
kill -TERM "$(cat "$tmp/pid")"
shows 'q again ends at once'
kill -TERM "$(cat "$tmp/pid")"
ended 143
shows_not 'learning curve'

# Signals in a row.
run watch --checkpoint "$checkpoint"
shows 'plays'
kill -TERM "$(cat "$tmp/pid")"
kill -TERM "$(cat "$tmp/pid")" 2>/dev/null || true
ended 143
shows_not 'Q-values'

# A terminal that can only print lines.
run_in() { press "clear; TERM=$1 $binary ${*:2}; echo code=\$?" Enter; }
run_in dumb watch --checkpoint "$checkpoint"
shows 'TERM=dumb'
ended 2
run_in dumb train --live --out refused
shows 'TERM=dumb'
ended 2
test ! -e "$tmp/refused"

# A terminal without a second screen: nothing of before shows through, and nothing of the view stays.
mux set-option -g alternate-screen off
press "clear; yes 'text of before' | head -n 20" Enter
shows 'text of before'
press "$binary watch --checkpoint $checkpoint; echo code=\$?" Enter
shows 'plays'
shows_not 'text of before'
press q
ended 0
shows_not 'Q-values'
mux set-option -g alternate-screen on

# A terminal that claims to be enormous.
press "clear; stty rows 60000 cols 60000; $binary watch --checkpoint $checkpoint; code=\$?; stty rows 24 cols 80; clear; echo code=\$code" Enter
sleep 3
press q
ended 0

resize 60 24
run train --live --out refused
shows '60 × 24'
ended 2
test ! -e "$tmp/refused"
# GNU screen, which draws into the tmux window.
if ! command -v screen >/dev/null; then
    echo 'FAILED: screen is not installed' >&2
    exit 1
fi
resize 80 24
mkdir -m 700 "$tmp/screen"
press "clear; SCREENDIR=$tmp/screen screen -c /dev/null -S view sh -c 'yes \"text of before\" | head -n 20; $binary watch --checkpoint $checkpoint; echo code=\$?; exec bash --norc'" Enter
shows 'plays'
shows_not 'text of before'
press q
shows '^code=0$'
shows_not 'Q-values'
press 'exit' Enter
shows 'screen is terminating'
press 'clear; echo us''able' Enter
shows '^usable$'

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
