#!/usr/bin/env bash
# Programs as environments: `tests/programs.sh BINARY BIN`, where BIN is the directory of a python3 with Gymnasium.
set -euo pipefail
cd "$(dirname "$0")/.."
binary=$(realpath "$1")
export PATH=$2:$PATH
repository=$PWD
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
fail() { printf 'FAILED: %s\n' "$*" >&2; exit 1; }
cd "$tmp"

cc -O2 -Wall -Wextra -Werror -ffp-contract=off -o dock "$repository/adapters/example.c" -lm
"$binary" train --config "$repository/adapters/example.json" --out dock-run --quiet
"$binary" eval dock-run --allow-command --min-mean -5

# The example in Python of docs/environments.md: the program, its dialogue, and the commands, as they stand on the page.
block() { awk -v mark="<!-- $1 -->" '$0 == mark {on = 1} on && /^```/ {if (++fences == 2) exit; next} fences' "$repository/docs/environments.md"; }
block 'file: room.py' > room.py
block 'dialogue: room.py' > dialogue
sed -n 's/^> //p' dialogue | python3 room.py > answers
[ "$(wc -l < answers)" -eq 4 ] || fail 'room.py does not answer four requests'
sed -n 's/^< //p' dialogue | diff - answers || fail 'room.py answers something else than the dialogue in docs/environments.md'
cartpole-dqn() { "$binary" "$@"; }
# shellcheck source=/dev/null
source <(block 'commands: room.py')
"$binary" eval runs/room --allow-command --min-mean -10

# CartPole-v1 through the adapter is our own CartPole-v1: the same returns of the same policy on the same seeds.
adapter() { printf '{"command": ["python3", "%s/adapters/gymnasium.py"%s]}' "$repository" "$(printf ', "%s"' "$@")"; }
short=(--set budget.steps=1500 --set replay.mirror=false --set evaluation.every_steps=500 --quiet)
"$binary" train --set "environment=$(adapter CartPole-v1 --return-range 0 500)" "${short[@]}" --out cartpole
"$binary" eval cartpole --allow-command --episodes 20 --json > theirs.json
python3 - "$binary" <<'PY'
import json, subprocess, sys
from safetensors.numpy import load_file, save_file
tensors = load_file("cartpole/checkpoints/best.safetensors")
save_file(tensors, "plain.safetensors")
ours = json.loads(subprocess.check_output([sys.argv[1], "eval", "plain.safetensors", "--episodes", "20", "--json"]))
theirs = json.load(open("theirs.json"))
assert ours["returns"] == theirs["returns"], (ours["returns"], theirs["returns"])
PY

# The same seed leaves the same bytes, in one process or in three.
"$binary" train --set "environment=$(adapter CartPole-v1 --return-range 0 500)" "${short[@]}" --out again
diff -rq cartpole/checkpoints again/checkpoints || fail 'two runs of one seed differ'
"$binary" train --set "environment=$(adapter CartPole-v1 --return-range 0 500)" --set environment.processes=3 "${short[@]}" --out three
cmp cartpole/metrics.jsonl three/metrics.jsonl || fail 'the number of processes changes the metrics'
"$binary" verify cartpole --allow-command --quiet

# A task in a module of one's own, in which an episode has a limit and a threshold.
cat > walk_task.py <<'PY'
import gymnasium
import numpy


class Walk(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-10, 10, (1,), numpy.float64)
    action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = self.np_random.uniform(-1, 1)
        return numpy.array([self.x]), {}

    def step(self, action):
        self.x += 0.25 if action else -0.25
        return numpy.array([self.x]), -abs(self.x), abs(self.x) > 2, False, {}


gymnasium.register("my/Walk-v3", Walk, max_episode_steps=17, reward_threshold=-5)
PY
for name in walk_task:my/Walk-v3 walk_task:my/Walk; do
    "$binary" train --set "environment=$(adapter "$name")" --set observation_divisors=null "${short[@]}" \
        --out "own-${#name}"
    python3 - "own-${#name}" <<'PY'
import json, sys
task = json.load(open(f"{sys.argv[1]}/config.json"))["environment"]["task"]
assert (task["max_steps"], task["solved_return"]) == (17, -5), task
PY
done

# What the adapter cannot play is said.
refused() {
    local words=$1 status=0
    shift
    "$binary" train --set "environment=$(adapter "$@")" --out refused 2> message || status=$?
    [ "$status" -eq 1 ] || fail "the exit code of $* is $status"
    grep -qF "$words" message || { cat message >&2; fail "$words is not in the message of $*"; }
    [ ! -e refused ] || fail "$* left a run"
}
refused 'the action space must be Discrete' Pendulum-v1
refused 'the observation space must be a Box of one dimension' FrozenLake-v1
refused 'NameNotFound' NoSuchTask-v0

# The adapter says how LunarLander is mirrored.
if python3 -c 'import Box2D' > /dev/null 2>&1; then
    python3 "$repository/tests/interop/lunar_lander_mirror.py"
fi

# Pictures.
if python3 -c 'import pygame' > /dev/null 2>&1; then
    "$binary" render cartpole --allow-command -o cartpole.gif --steps 20
    "$binary" render cartpole --allow-command -o cartpole.gif --steps 20 --quiet
    head -c 6 cartpole.gif | grep -q GIF89a || fail 'the film is no GIF'
fi
echo 'programs as environments: well'
