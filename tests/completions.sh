#!/usr/bin/env bash
# Types commands into bash, zsh and fish, presses Tab, and looks at what the shell makes of them.
# Usage: tests/completions.sh BINARY
set -euo pipefail
binary=$(realpath "$1")
tmp=$(mktemp -d)
export LC_ALL=C.UTF-8 HOME=$tmp PATH=$tmp:$PATH
unset ENV XDG_CONFIG_HOME XDG_DATA_HOME

for program in tmux bash zsh fish; do
    command -v "$program" >/dev/null || { echo "FAILED: $program is not installed" >&2; exit 1; }
done
mux() { tmux -u -L "cartpole-dqn-$$" -f /dev/null "$@"; }
trap 'mux kill-server 2>/dev/null || true; rm -rf "$tmp"' EXIT
# Without a session the server ends, and a session that is made at that moment would fail.
mux new-session -d -s keeper

ln -s "$binary" "$tmp/cartpole-dqn"
mkdir -p "$tmp/work/runs/first" "$tmp/work/my configs"
cd "$tmp/work"
touch 'my configs/deep.json'
echo '{}' >runs/first/config.json

# Waits until the screen holds a text.
shows() {
    for _ in $(seq 100); do
        if mux capture-pane -p -J -t shell | grep -qF -- "$1"; then return; fi
        sleep 0.1
    done
    printf 'FAILED in %s: %s\nThe screen does not show "%s":\n' "$shell" "$2" "$1" >&2
    mux capture-pane -p -t shell >&2
    exit 1
}
# What a word typed before a Tab, or before two, becomes.
completes() {
    mux send-keys -t shell C-u
    mux send-keys -t shell C-l
    sleep 0.2
    mux send-keys -t shell -l "cartpole-dqn $1"
    for _ in $(seq "${3:-1}"); do
        sleep 0.2
        mux send-keys -t shell Tab
    done
    shows "$2" "cartpole-dqn $1<Tab>"
}

check() {
    shell=$1
    mux new-session -d -s shell -x 120 -y 40 -c "$tmp/work" "$2"
    mux send-keys -t shell -l "$3; echo rea''dy"
    mux send-keys -t shell Enter
    shows ready 'its start'

    completes 'tra' 'cartpole-dqn train'
    completes 'help insp' 'help inspect'
    completes 'config sh' 'config show'
    completes 'train --con' 'train --config'
    completes 'completions fi' 'completions fish'
    completes 'eval --policy r' '--policy random'
    completes 'train --quiet --tens' '--quiet --tensorboard'
    completes 'train --set gam' '--set gamma='
    completes 'train --set loss=h' 'loss=huber'
    completes 'train --set gamma=0.9 --set loss=mse --set doub' '--set double='
    completes 'train --set=double=f' '--set=double=false'
    completes 'train --set optimizer.schedule.' 'schedule.final_learning_rate=' 2
    completes 'study --vary loss=mse,h' 'loss=mse,huber'
    completes 'train --config tut' '--config tutorial'
    completes 'study --config=lu' '--config=lunar_lander'
    completes 'train --config my' 'my\ configs/'
    completes 'train --config my\ configs/d' 'my\ configs/deep.json'
    completes 'render --output my' 'my\ configs/'
    completes 'train --out=ru' '--out=runs/'
    completes 'eval --checkpoint ' 'first' 2
    for command in 'eval --checkpoint' 'inspect --checkpoint' 'watch --checkpoint' 'render --checkpoint' \
        'train --resume' report verify; do
        completes "$command runs/f" "$command runs/first/"
    done
    mux kill-session -t shell
}

check bash 'PS1="$ " bash --norc' 'source <(cartpole-dqn completions bash)'
check zsh 'PS1="$ " zsh -f' 'autoload -U compinit; compinit -u; source <(cartpole-dqn completions zsh)'
check fish 'fish --no-config' 'cartpole-dqn completions fish | source'
echo 'completions work in bash, zsh and fish'
