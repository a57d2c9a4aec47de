"""Records gymnasium_cartpole_edges.json beside this file: the ends of an episode and the seeds that chance rarely visits."""

import importlib.metadata
import json
from pathlib import Path

import gymnasium
import numpy as np


def lean(target):
    """Holds the pole at the angle `target` (radians), so that the cart must accelerate to that side."""
    return lambda step, state: int(state[2] - target + 0.5 * state[3] > 0)


def balance(step, state):
    return int(0.1 * state[0] + 0.2 * state[1] + state[2] + 0.5 * state[3] > 0)


def push(action):
    return lambda step, state: action


def balance_until(last, action):
    return lambda step, state: balance(step, state) if step < last else action


def random(seed):
    generator = np.random.default_rng(seed)
    return lambda step, state: int(generator.integers(2))


def record(env, seed, name, policy):
    env.reset(seed=seed)
    initial_state = env.unwrapped.state.tolist()
    state, actions, states = initial_state, [], []
    terminated = truncated = False
    while not (terminated or truncated):
        action = policy(len(actions), state)
        _, reward, terminated, truncated, _ = env.step(action)
        assert reward == 1.0
        state = env.unwrapped.state.tolist()
        actions.append(action)
        states.append(state)
    return {
        "seed": seed,
        "policy": name,
        "initial_state": initial_state,
        "actions": actions,
        "states": states,
        "terminated": terminated,
        "truncated": truncated,
        "length": len(actions),
    }


def left_track(episode, side):
    x, _, theta, _ = episode["states"][-1]
    return episode["terminated"] and side * x > 2.4 and abs(theta) <= 12 * 2 * np.pi / 360


def main():
    env = gymnasium.make("CartPole-v1")

    right = [record(env, seed, "lean-right", lean(0.05)) for seed in (100, 101)]
    left = [record(env, seed, "lean-left", lean(-0.05)) for seed in (102, 103)]
    assert all(left_track(episode, +1) for episode in right)
    assert all(left_track(episode, -1) for episode in left)

    full = record(env, 104, "balance", balance)
    assert full["truncated"] and not full["terminated"]

    # Given up early enough that the pole falls on step 500, which is then both terminated and truncated.
    both = record(env, 105, "balance-then-push-left", balance_until(490, 0))
    assert both["truncated"] and both["terminated"]

    pushed = [record(env, 106, "push-left", push(0)), record(env, 107, "push-right", push(1))]
    seeds = (2**32 - 1, 2**32, 2**32 + 1, 2**40 + 7, 2**63, 2**64 - 1)
    wide = [record(env, seed, "random", random(seed)) for seed in seeds]

    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("gymnasium", "numpy"))
    recording = {
        "source": f"{versions}, gym.make('CartPole-v1')",
        "note": "states[i] is the float64 state after actions[i]; reset(seed=seed) gave initial_state; reward is 1.0 at every step",
        "episodes": [*right, *left, full, both, *pushed, *wide],
    }
    path = Path(__file__).with_name("gymnasium_cartpole_edges.json")
    path.write_text(json.dumps(recording, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
