"""Plays a checkpoint in Gymnasium's environment of its name with NumPy and requires what `cartpole-dqn eval` reports.

Every step of the trace is checked on its own: Gymnasium and NumPy, put into its state, must give its Q-values and its
next state. Then Gymnasium plays every episode freely, from the same seed, and must take the same actions to the same
return. There the two sides may part: their sine and cosine differ in the last bit now and then, and the pole, while
both take the same actions, multiplies a difference by 1.08 at every step, so that 1e-17 can grow beyond 1e-6 within an
episode and tip an action. Only 2 in 100 episodes may part. How many do depends on the policy: of the best checkpoints
of the seeds 1 to 5 of an earlier default it was 3, 0, 0, 2 and 2, every return being 500 on both sides.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
from itertools import groupby
from pathlib import Path

import gymnasium
import numpy as np
from safetensors import safe_open
from safetensors.numpy import load_file

# Relative to max(1, |value|). A single step may differ in the last bits alone.
TOLERANCE = 1e-6
STEP_TOLERANCE = 1e-14
SOLVED_EPISODES = 100
MAX_PARTED_PER_100 = 2


class Disagreement(Exception):
    pass


def require(condition, message):
    if not condition:
        raise Disagreement(message)


def load_policy(path):
    """The layers [(weight (out, in), bias (out))] of the policy; tensors of the rest of a checkpoint have a prefix."""
    tensors = load_file(path)
    layers = sorted(int(match[1]) for name in tensors if (match := re.fullmatch(r"(\d+)\.weight", name)))
    require(layers, f"{path}: no tensor is called like 0.weight; it has {sorted(tensors)}")
    require(layers == list(range(0, 2 * len(layers), 2)), f"{path}: layers {layers} are not Linear and ReLU in turn")
    policy = [(tensors[f"{i}.weight"], tensors[f"{i}.bias"]) for i in layers]
    require(all(t.dtype == np.float32 for layer in policy for t in layer), f"{path}: the weights are not float32")
    return policy


def task_of(path):
    """The environment, and by what `eval --trace` divides the network's output, so that Q-values are in units of its rewards."""
    with safe_open(path, framework="numpy") as file:
        header = (file.metadata() or {}).get("cartpole-dqn")
    config = json.loads(header)["config"] if header else {}
    return config.get("environment", "CartPole-v1"), config.get("reward_scale", 1.0)


def observe(env, state):
    """What an agent sees in a state."""
    if env.spec.id != "Acrobot-v1":
        return np.float32(state)
    env.unwrapped.state = np.array(state)
    return env.unwrapped._get_ob()


def q_values(policy, observations):
    """Q-values (batch, actions) in float32, each sum fused and in the order of docs/determinism.md.

    Rounding in another order, as in `weight @ x`, turns enough near-ties to part several in 100 long episodes.
    """
    x = observations.T
    for layer, (weight, bias) in enumerate(policy):
        y = bias[:, None]
        for column, row in zip(weight.T, x):
            y = (np.multiply.outer(column, row, dtype=np.float64) + y).astype(np.float32)
        x = np.maximum(y, np.float32(0)) if layer < len(policy) - 1 else y
    return x.T


def close(ours, theirs, tolerance=TOLERANCE):
    ours, theirs = np.float64(ours), np.float64(theirs)
    return ours.shape == theirs.shape and np.all(np.abs(ours - theirs) <= tolerance * np.maximum(1, np.abs(theirs)))


def run_eval(arguments):
    with tempfile.TemporaryDirectory() as directory:
        trace_path = Path(directory) / "trace.jsonl"
        command = [arguments.binary, "eval", "--checkpoint", arguments.checkpoint, "--episodes", arguments.episodes]
        command += ["--seed", arguments.seed, "--json", "--trace", trace_path]
        run = subprocess.run([str(word) for word in command], stdout=subprocess.PIPE, check=False)
        require(run.returncode == 0, f"eval exited with {run.returncode}")
        with trace_path.open() as trace:
            steps = [json.loads(line) for line in trace]
    return json.loads(run.stdout), [list(episode) for _, episode in groupby(steps, key=lambda s: s["episode"])]


def check_trace(trace, episode, seed, total_return):
    where = f"trace of seed {seed}"
    require(all((s["episode"], s["seed"]) == (episode, seed) for s in trace), f"{where}: not episode {episode}")
    require([s["step"] for s in trace] == list(range(len(trace))), f"{where}: steps are missing or out of order")
    # Divided by the reward scale, two Q-values that differ in the last bit can become the same.
    greedy = all(s["q_values"][s["action"]] == max(s["q_values"]) for s in trace)
    require(greedy, f"{where}: an action is not the greedy one")
    rewards = sum(s["reward"] for s in trace)
    require(rewards == total_return, f"{where}: rewards of {rewards}, but a return of {total_return}")
    *before, last = (s["terminated"] or s["truncated"] for s in trace)
    require(last and not any(before), f"{where}: does not end with its last step")


def check_each_step(env, policy, scale, seed, trace):
    env.reset(seed=seed)
    initial_state = env.unwrapped.state.tolist()
    require(trace[0]["state"] == initial_state, f"seed {seed}: starts in {trace[0]['state']}, not {initial_state}")

    qs = q_values(policy, np.array([observe(env, s["state"]) for s in trace])) / scale
    for step, (theirs, after, q) in enumerate(zip(trace, [*trace[1:], None], qs)):
        where = f"seed {seed}, step {step}"
        require(close(q, theirs["q_values"]), f"{where}: Q-values {theirs['q_values']}, in NumPy {q.tolist()}")

        env.unwrapped.state = np.array(theirs["state"])
        _, *ours = env.step(theirs["action"])
        outcome = [theirs["reward"], theirs["terminated"], theirs["truncated"]]
        require(ours[:3] == outcome, f"{where}: (reward, terminated, truncated) {outcome}, in Gymnasium {ours[:3]}")
        state = np.array(env.unwrapped.state)
        require(
            after is None or close(state, after["state"], STEP_TOLERANCE),
            f"{where}: leads to {after and after['state']}, in Gymnasium to {state.tolist()}",
        )


def play_freely(env, policy, scale, seed, trace):
    """Whether the episode parted, and whether its states or Q-values came to differ by more than TOLERANCE."""
    observation, _ = env.reset(seed=seed)
    drifted = False
    for step, theirs in enumerate(trace):
        state = np.array(env.unwrapped.state)
        (q,) = q_values(policy, observation[None])
        drifted = drifted or not (close(state, theirs["state"]) and close(q / scale, theirs["q_values"]))

        action = int(np.argmax(q))
        if action != theirs["action"]:
            apart = np.max(np.abs(state - theirs["state"]))
            print(f"seed {seed}, step {step}: parted, Q-values {theirs['q_values']}, in NumPy {(q / scale).tolist()}")
            print(f"  states {apart:.1e} apart, {'beyond' if drifted else 'within'} {TOLERANCE} until here")
            return True, drifted

        observation, _, *ours = env.step(action)
        end = [theirs["terminated"], theirs["truncated"]]
        require(ours[:2] == end, f"seed {seed}, step {step}: (terminated, truncated) {end}, in Gymnasium {ours[:2]}")
    return False, drifted


def check_summary(summary, arguments, threshold):
    returns = np.array(summary["returns"], dtype=np.float64)
    expected = {
        "mean": returns.mean(),
        "std": returns.std(),
        "min": returns.min(),
        "median": np.median(returns),
        "max": returns.max(),
    }
    require(summary["episodes"] == arguments.episodes, f"episodes is {summary['episodes']}")
    require(summary["seed"] == arguments.seed, f"seed is {summary['seed']}")
    require(len(returns) == arguments.episodes, f"{len(returns)} returns for {arguments.episodes} episodes")
    for name, value in expected.items():
        require(np.isclose(summary[name], value, rtol=1e-9, atol=1e-9), f"{name} is {summary[name]}, in NumPy {value}")
    solved = bool(returns.mean() >= threshold) if len(returns) >= SOLVED_EPISODES else None
    require(summary["solved"] is solved, f"solved is {summary['solved']} with a mean of {returns.mean()}")


def compare(arguments):
    policy, (name, scale) = load_policy(arguments.checkpoint), task_of(arguments.checkpoint)
    env = gymnasium.make(name)
    summary, traces = run_eval(arguments)
    check_summary(summary, arguments, env.spec.reward_threshold)
    require(len(traces) == arguments.episodes, f"the trace has {len(traces)} episodes, not {arguments.episodes}")

    outcomes = []
    for episode, (trace, total_return) in enumerate(zip(traces, summary["returns"])):
        seed = arguments.seed + episode
        check_trace(trace, episode, seed, total_return)
        check_each_step(env, policy, scale, seed, trace)
        outcomes.append(play_freely(env, policy, scale, seed, trace))
    parted, drifted = (sum(flags) for flags in zip(*outcomes))

    mean = summary["mean"]
    steps = sum(map(len, traces))
    print(f"{len(traces)} episodes, {steps} steps, mean return {mean:.2f}: {parted} parted, {drifted} drifted")
    require(100 * parted <= MAX_PARTED_PER_100 * arguments.episodes, f"{parted} episodes parted")
    if arguments.expect:
        require((mean >= env.spec.reward_threshold) == (arguments.expect == "solved"), f"expected {arguments.expect}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", required=True, type=Path, help="the cartpole-dqn to compare with")
    parser.add_argument("--checkpoint", required=True, type=Path, help="a .safetensors file that it wrote")
    parser.add_argument("--episodes", type=int, default=100, help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=2_000_000, help="of the first episode; default: %(default)s")
    parser.add_argument("--expect", choices=["solved", "unsolved"], help="require a mean of at least the threshold, or below")
    try:
        compare(parser.parse_args())
    except Disagreement as disagreement:
        print(f"FAILED: {disagreement}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
