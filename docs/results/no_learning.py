"""What common mistakes do to a plain DQN on CartPole-v1, for docs/no_learning.md: each is planted in the same 100 lines of NumPy and trained with
several seeds.

    python no_learning.py --results FILE.jsonl [--seeds 0 1 2 3 4]      # goes on where it was stopped
    python no_learning.py --results FILE.jsonl --table

Needs numpy."""

import argparse
import json
import math
import pathlib

import numpy as np

STEPS, GAMMA, RATE, BATCH, CAPACITY, WARM_UP, PERIOD, LIMIT = 10_000, 0.99, 1e-3, 32, 10_000, 500, 200, 500
SIZES = (4, 64, 64, 2)
EVALUATED_EVERY, EPISODES = 1000, 20


def physics(state, action):
    """Gymnasium's CartPole-v1, of one state or of columns of them."""
    x, v, angle, w = state
    sine, cosine = (np.sin(angle), np.cos(angle)) if isinstance(angle, np.ndarray) else (math.sin(angle), math.cos(angle))
    push = (10.0 * (2 * action - 1) + 0.05 * w * w * sine) / 1.1
    turn = (9.8 * sine - cosine * push) / (0.5 * (4 / 3 - 0.1 * cosine * cosine / 1.1))
    return x + 0.02 * v, v + 0.02 * (push - 0.05 * turn * cosine / 1.1), angle + 0.02 * w, w + 0.02 * turn


class Network:
    """Dense layers with ReLU between them, all weights in one array."""

    def __init__(self, rng):
        shapes = [shape for i, o in zip(SIZES, SIZES[1:]) for shape in ((i, o), (o,))]
        ends = np.cumsum([math.prod(shape) for shape in shapes])
        self.shapes, self.ends = shapes, ends
        limits = np.repeat([shape[0] ** -0.5 for shape in shapes[::2] for _ in range(2)], [math.prod(shape) for shape in shapes])
        self.flat = (rng.uniform(-1, 1, ends[-1]) * limits).astype(np.float32)
        self.layers = self.views(self.flat)

    def views(self, flat):
        return [flat[end - math.prod(shape) : end].reshape(shape) for shape, end in zip(self.shapes, self.ends)]

    def forward(self, x, relu_output=False):
        inputs, layers = [], self.layers
        for i in range(0, 6, 2):
            inputs.append(x)
            x = x @ layers[i] + layers[i + 1]
            if i < 4 or relu_output:
                x = np.maximum(x, 0)
        return inputs, x

    def backward(self, inputs, dy):
        gradient = np.empty_like(self.flat)
        views = self.views(gradient)
        for i in (4, 2, 0):
            views[i][:], views[i + 1][:] = inputs[i // 2].T @ dy, dy.sum(0)
            dy = (dy @ self.layers[i].T) * (inputs[i // 2] > 0)
        return gradient


def evaluated(network, rng, relu_output):
    """The mean return of greedy episodes."""
    states, alive, total = rng.uniform(-0.05, 0.05, (4, EPISODES)), np.ones(EPISODES, bool), 0
    for _ in range(LIMIT):
        q = network.forward(states.T.astype(np.float32), relu_output)[1]
        states = np.stack(physics(states, q.argmax(1)))
        total += alive.sum()
        alive &= (np.abs(states[0]) <= 2.4) & (np.abs(states[2]) <= math.pi / 15)
        if not alive.any():
            break
    return float(total / EPISODES)


class Learner:
    def __init__(self, rng, mistake):
        self.rng, self.mistake, self.online, self.target = rng, mistake, Network(rng), Network(rng)
        self.relu_output = mistake == "output_relu"
        self.copy()
        self.first, self.second, self.steps, self.updates = np.zeros_like(self.online.flat), np.zeros_like(self.online.flat), 0, 0
        self.sum = np.zeros_like(self.online.flat)
        self.rate = {"rate_0.1": 0.1, "rate_0.01": 0.01, "rate_1e-5": 1e-5}.get(mistake, RATE)
        if mistake == "target_is_online":
            self.target = self.online

    def copy(self):
        if self.target is not self.online:
            self.target.flat[:] = self.online.flat

    def update(self, s, a, r, s2, ends):
        mistake, rows = self.mistake, np.arange(len(a))
        inputs2, q2 = self.target.forward(s2, self.relu_output)
        if mistake == "terminal_bootstrapped":
            ends = np.zeros_like(ends)
        best = q2.argmax(1)
        y = r + np.float32(GAMMA) * (1 - ends) * q2[rows, best]
        inputs, q = self.online.forward(s, self.relu_output)
        dq = np.zeros_like(q)
        if mistake == "every_pair":  # [B, 1] against [B]: each row is drawn to the mean of all targets.
            error = q[rows, a] - y.mean()
        else:
            error = q[rows, a] - y
        scale = 2.0 if mistake == "sum" else 2.0 / len(a)
        dq[rows, a] = scale * error * ((q[rows, a] > 0) if self.relu_output else 1)
        gradient = self.online.backward(inputs, dq)
        if mistake == "gradient_through_target":
            d2 = np.zeros_like(q2)
            d2[rows, best] = -scale * error * GAMMA * (1 - ends)
            gradient += self.online.backward(inputs2, d2)
        if mistake == "gradient_accumulated":
            self.sum += gradient
            gradient = self.sum
        if mistake == "optimizer_made_anew":
            self.first[:], self.second[:], self.steps = 0, 0, 0
        self.steps += 1
        self.updates += 1
        self.first += np.float32(0.1) * (gradient - self.first)
        self.second += np.float32(0.001) * (gradient * gradient - self.second)
        step = self.first / np.float32(1 - 0.9**self.steps) / (np.sqrt(self.second / np.float32(1 - 0.999**self.steps)) + np.float32(1e-8))
        self.online.flat += np.float32(self.rate if mistake == "ascent" else -self.rate) * step
        period = {"target_updated_too_rarely": 4000, "target_never_updated": 10**9}.get(mistake, PERIOD)
        if self.updates % period == 0:
            self.copy()
        return float(np.abs(y).max())


def epsilon_of(mistake, step):
    if mistake == "never_explores":
        return 0.0
    if mistake == "epsilon_never_falls":
        return 1.0
    if mistake == "epsilon_falls_at_once":
        return 0.05 if step > 30 else 1.0
    return max(0.05, 1 - step / 3000)


def train(mistake, seed):
    """Greedy returns every 1,000 steps, the largest target, and the mean return of the last 20 training episodes."""
    np.seterr(all="ignore")
    rng = np.random.default_rng([seed, 11])
    learner = Learner(rng, mistake)
    capacity = 2 * BATCH if mistake == "memory_too_small" else CAPACITY
    columns = [np.zeros((capacity, 4), np.float32), np.zeros(capacity, int), np.zeros(capacity, np.float32), np.zeros((capacity, 4), np.float32), np.zeros(capacity, np.float32)]
    fresh = lambda: tuple(np.random.default_rng(5).uniform(-0.05, 0.05, 4) if mistake == "same_start_every_episode" else rng.uniform(-0.05, 0.05, 4))
    state, start, length, stored = fresh(), None, 0, 0
    curve, returns, largest = [], [], 0.0
    for step in range(STEPS):
        seen = start = state if start is None or mistake != "state_not_advanced" else start
        if rng.random() < epsilon_of(mistake, step):
            action = int(rng.integers(2))
        else:
            q = learner.online.forward(np.array(seen, np.float32)[None], learner.relu_output)[1][0]
            action = int(q.argmin() if mistake == "greedy_is_not_the_largest" else q.argmax())
        following = physics(state, action)
        length += 1
        terminated = not (abs(following[0]) <= 2.4 and abs(following[2]) <= math.pi / 15)
        truncated = length == LIMIT
        place = stored % capacity
        done = {"terminated_never_stored": False, "time_limit_stored_as_terminated": terminated or truncated}.get(mistake, terminated)
        kept = int(rng.integers(2)) if mistake == "stored_action_is_another" else action
        values = (following if mistake == "next_is_current" else seen, kept, 1.0, following, done)
        for column, value in zip(columns, values):
            column[place] = value
        stored += 1
        state = following
        ended = terminated or truncated
        if ended:
            returns.append(length)
            state, start, length = fresh(), None, 0
        due = step >= WARM_UP and (ended if mistake == "learns_at_episode_ends_only" else True)
        if due:
            rows = rng.integers(min(stored, capacity), size=BATCH)
            if mistake == "samples_only_newest":
                rows = (stored - 1 - np.arange(BATCH)) % capacity
            largest = max(largest, learner.update(*(column[rows] for column in columns)))
        if step % EVALUATED_EVERY == EVALUATED_EVERY - 1:
            curve.append(evaluated(learner.online, np.random.default_rng([seed, step]), learner.relu_output))
    return {"mistake": mistake, "seed": seed, "curve": curve, "largest_target": largest if math.isfinite(largest) else None, "training": float(np.mean(returns[-20:]))}


MISTAKES = [
    "", "every_pair", "terminal_bootstrapped", "terminated_never_stored", "next_is_current", "stored_action_is_another", "state_not_advanced",
    "ascent", "output_relu", "greedy_is_not_the_largest", "epsilon_never_falls", "epsilon_falls_at_once", "never_explores", "target_never_updated",
    "target_updated_too_rarely", "target_is_online", "gradient_through_target", "gradient_accumulated", "optimizer_made_anew", "rate_0.1", "rate_0.01",
    "rate_1e-5", "memory_too_small", "samples_only_newest", "time_limit_stored_as_terminated", "learns_at_episode_ends_only",
    "same_start_every_episode", "sum",
]  # fmt: skip


def table(results):
    print("| mistake | seeds | mean greedy return, last three evaluations: median (lowest to highest seed) | best evaluation, median | largest target, median | last 20 training episodes, median |")
    print("| --- | --- | --- | --- | --- | --- |")
    for mistake in MISTAKES:
        runs = [one for one in results if one["mistake"] == mistake]
        if not runs:
            continue
        finals = sorted(np.mean(one["curve"][-3:]) for one in runs)
        targets = np.median([one["largest_target"] or np.inf for one in runs])
        training = np.median([one["training"] for one in runs])
        best = np.median([max(one["curve"]) for one in runs])
        print(f"| {mistake or 'none'} | {len(runs)} | {np.median(finals):.0f} ({finals[0]:.0f} to {finals[-1]:.0f}) | {best:.0f} | {targets:.3g} | {training:.0f} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", required=True, type=pathlib.Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(5)))
    parser.add_argument("--only", nargs="+", default=MISTAKES)
    parser.add_argument("--table", action="store_true")
    arguments = parser.parse_args()
    results = [json.loads(line) for line in arguments.results.read_text().splitlines()] if arguments.results.exists() else []
    if arguments.table:
        return table(results)
    known = {(one["mistake"], one["seed"]) for one in results}
    for seed in arguments.seeds:
        for mistake in arguments.only:
            if (mistake, seed) not in known:
                with arguments.results.open("a") as file:
                    file.write(json.dumps(train(mistake, seed)) + "\n")


if __name__ == "__main__":
    main()
