#!/usr/bin/env python3
"""Records DQN loops in NumPy with `cartpole_dqn.Recorder` and lets `cartpole-dqn check` judge them: with each of many planted mistakes,
`check` must name that one; of a right loop it must name nothing.

    python recorder.py --binary target/release/cartpole-dqn                                 # what CI runs
    python recorder.py --binary BINARY --steps 1500 3000 --seeds 5 --table                  # shares, and false alarms

Needs numpy and gymnasium."""

import argparse
import io
import json
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import gymnasium
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "python"))
from cartpole_dqn import Recorder  # noqa: E402
from check_numpy import backward, forward  # noqa: E402

GAMMA, RATE = 0.98, 2e-3


class Learner:
    """Two networks and Adam."""

    def __init__(self, rng, sizes, rate=RATE, sgd=False):
        layers = list(zip(sizes, sizes[1:]))
        make = lambda: [w for i, o in layers for w in (rng.uniform(-1, 1, (i, o)) / i**0.5, rng.uniform(-1, 1, o) / i**0.5)]
        self.online, self.other = ([w.astype(np.float32) for w in make()] for _ in range(2))
        self.target = [w.copy() for w in self.online]
        self.rate, self.sgd, self.frozen = rate, sgd, ()
        self.forget()

    def forget(self):
        self.adam = [0, [np.zeros_like(w) for w in self.online], [np.zeros_like(w) for w in self.online]]

    def update(self, batch, double=False, moves=True):
        """The TD targets and the loss of one update, which changes the online network in place."""
        rows = np.arange(len(batch["actions"]))
        q_next = forward(self.target, batch["next_observations"])[1]
        best = forward(self.online, batch["next_observations"])[1].argmax(1) if double else q_next.argmax(1)
        y = batch["rewards"] + batch["discounts"] * (1 - batch["terminated"]) * q_next[rows, best]
        inputs, q = forward(self.online, batch["observations"])
        error = q[rows, batch["actions"]] - y
        dy = np.zeros_like(q)
        dy[rows, batch["actions"]] = 2 * error / len(rows)
        gradients = backward(self.online, inputs, dy)
        self.adam[0] += 1
        t = self.adam[0]
        for index, (w, g, m, v) in enumerate(zip(self.online, gradients, self.adam[1], self.adam[2])):
            m += np.float32(0.1) * (g - m)
            v += np.float32(0.001) * (g * g - v)
            step = g if self.sgd else m / np.float32(1 - 0.9**t) / (np.sqrt(v / np.float32(1 - 0.999**t)) + np.float32(1e-8))
            if moves and index not in self.frozen:
                w -= np.float32(self.rate) * step.astype(np.float32)
        return y.astype(np.float32), float((error**2).mean())


class Shaped(gymnasium.RewardWrapper):
    """Rewards that differ from step to step."""

    def reward(self, reward):
        return float(reward - abs(self.unwrapped.state[0]))


class Leaves(gymnasium.Wrapper):
    """An end of its own."""

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated or abs(observation[0]) > 0.3, truncated, info


def batch_of(memory, chosen):
    columns = list(zip(*(memory[i] for i in chosen)))
    names = ("observations", "actions", "rewards", "next_observations", "terminated", "truncated", "discounts")
    types = (np.float32, np.int64, np.float32, np.float32, np.float32, np.float32, np.float32)
    return {name: np.array(column, dtype) for name, column, dtype in zip(names, columns, types)}


def loop(
    path, mistake="", seed=0, steps=1500, task="CartPole-v1", limit=50, epsilon="linear", every=1, target="hard", period=100,
    capacity=5000, size=32, warm_up=100, double=False, n=1, wrapper=None, scale=1.0, clip=False, sgd=False, told=("q", "epsilon"),
    rate=RATE, optimizer=False,
):
    """A DQN loop with one environment, right or with a mistake."""
    rng = np.random.default_rng([seed, 29])
    recorder = Recorder(path, gamma=GAMMA, learning_rate=abs(rate))
    env = gymnasium.make(task, max_episode_steps=limit)
    if mistake == "reward_of_another_step":
        env = Shaped(env)
    env = recorder.environment(wrapper(env) if wrapper else env)
    num_actions, features = env.action_space.n, env.observation_space.shape[0]
    learner = Learner(rng, [features, 32, 32, num_actions], rate, sgd)
    if mistake == "target_is_online":
        learner.target = learner.online
    if mistake == "target_not_initialised":
        learner.target = learner.other
    if mistake == "layer_never_changes":
        learner.frozen = (0,)
    if mistake == "units_die":
        learner.online[3][:] = learner.target[3][:] = -9
    if mistake == "learns_before_a_batch_is_there":
        warm_up = 2
    if mistake == "memory_too_small":
        capacity = 2 * size
    memory, window = [], []
    observation, _ = env.reset(seed=seed)
    eps, reward_before, q_before, episode, start_of_episode = 1.0, 0.0, None, 0, observation
    for step in range(steps):
        share = min(step / (0.5 * steps), 1)
        eps = {
            "linear": 1 - 0.95 * share, "constant": 0.1, "per_episode": max(0.05, 0.97**episode), "slow": 0.05 + 0.85 * np.exp(-step / 1000),
            "epsilon_never_falls": 1.0, "epsilon_falls_at_once": 0.05 if step > 20 else 1.0, "epsilon_grows": 0.1 + 0.8 * share,
            "never_explores": 0.0, "cycles": 0.05 + 0.4 * (1 - (step % 400) / 400),
        }[mistake if mistake.startswith("epsilon_") and mistake[8:] in ("never_falls", "falls_at_once", "grows") else "never_explores" if mistake == "never_explores" else epsilon]  # fmt: skip
        evaluates = mistake == "learns_while_evaluating" and episode % 5 == 4
        eps = 0.0 if evaluates else eps
        q = forward(learner.online, observation[None].astype(np.float32))[1][0]
        greedy = int(q.argmin() if mistake == "greedy_is_not_the_largest" else q.argmax())
        if mistake == "acts_on_an_old_observation" and q_before is not None:
            q, q_before = q_before, q
            greedy = int(q.argmax())
        elif mistake == "acts_on_an_old_observation":
            q_before = q
        explores = rng.random() < eps
        if mistake == "epsilon_not_applied":
            explores = False
        if mistake == "epsilon_inverted":
            explores = rng.random() >= eps
        action = int(rng.integers(num_actions)) if explores else greedy
        if mistake == "exploration_misses_an_action" and explores:
            action = int(rng.integers(num_actions - 1))
        recorder.acting(q_values=q if "q" in told else None, epsilon=eps if "epsilon" in told else None)
        following, reward, terminated, truncated, _ = env.step(action)
        ended = terminated or (truncated and mistake != "truncation_ignored")
        stored_observation, stored_next = observation, following
        if mistake == "next_is_current":
            stored_observation = following
        if mistake == "observation_changed":
            stored_observation = observation / [2.4, 1, 0.2, 1]
        stored_reward = np.clip(reward * scale, -0.5, 0.5) if clip else reward * scale
        if mistake == "reward_of_another_step":
            stored_reward, reward_before = reward_before, reward
        stored_end = terminated or (truncated and mistake == "time_limit_stored_as_terminated")
        if mistake == "terminated_never_stored":
            stored_end = False
        if mistake == "stored_action_is_another":
            action = int(rng.integers(num_actions))
        if ended and mistake not in ("steps_after_the_end",):
            fresh, _ = env.reset(seed=7 if mistake == "same_start_every_episode" else None)
            if mistake == "next_is_reset":
                stored_next = fresh
            episode += 1
        row = [stored_observation, action, stored_reward, stored_next, stored_end, truncated, GAMMA]
        window.append(row)
        for i, first in enumerate(window[:-1]):
            first[2] += GAMMA ** (len(window) - 1 - i) * stored_reward
            first[3:6] = stored_next, stored_end, truncated
            first[6] = GAMMA ** (len(window) - i)
        done = window if ended else window[:1] if len(window) == n else []
        memory += [tuple(one) for one in done]
        window = [] if ended else window[1:] if done else window
        memory = memory[-capacity:]
        if mistake != "state_not_advanced":
            observation = following
        if ended and mistake not in ("steps_after_the_end",):
            observation = fresh
            if mistake == "memory_emptied":
                memory = []
        is_due = step % every == 0 and (len(memory) >= size or mistake == "learns_before_a_batch_is_there")
        if mistake == "learns_at_episode_ends_only":
            is_due = ended and len(memory) >= size
        if step < warm_up or not is_due or not memory:
            continue
        chosen = rng.integers(len(memory), size=size)
        if mistake == "one_transition_repeated":
            chosen[:] = chosen[0]
        if mistake == "samples_only_newest":
            chosen = np.arange(len(memory) - size, len(memory))
        if mistake == "samples_only_oldest":
            chosen = rng.integers(min(len(memory), 2 * size), size=size)
        batch = batch_of(memory, chosen)
        if mistake == "row_that_never_happened":
            batch["next_observations"] = batch["next_observations"][rng.permutation(size)]
        if mistake == "optimizer_made_anew":
            learner.forget()
        before = (learner.adam[0], [m.copy() for m in learner.adam[1]], [v.copy() for v in learner.adam[2]]) if optimizer else None
        y, loss = learner.update(batch, double, mistake != "online_never_changes")
        updates = step // every
        if target == "soft" and mistake not in ("target_never_updated", "online_overwritten_by_target"):
            tau = 0.99 if mistake == "tau_reversed" else 0.01
            for w, t in zip(learner.online, learner.target):
                t += np.float32(tau) * (w - t)
        elif mistake == "target_updated_too_rarely":
            if step % 500 == 0:
                for w, t in zip(learner.online, learner.target):
                    t += np.float32(0.005) * (w - t)
        elif mistake == "online_overwritten_by_target":
            if updates % period == 0:
                for w, t in zip(learner.online, learner.target):
                    w[:] = t
        elif mistake not in ("target_never_updated", "target_is_online") and updates % period == 0:
            learner.target = [w.copy() for w in learner.online]
        recorder.learned(learner.online, learner.target, batch, y, loss, before if optimizer else None)
    recorder.close()


def vector_loop(path, mistake="", seed=0, steps=1500, mode="NEXT_STEP", limit=50, count=4):
    """A right loop with several environments."""
    rng = np.random.default_rng([seed, 30])
    recorder = Recorder(path, gamma=GAMMA, learning_rate=RATE)
    autoreset = getattr(gymnasium.vector.AutoresetMode, mode)
    make = lambda: gymnasium.make("CartPole-v1", max_episode_steps=limit)
    env = recorder.environment(gymnasium.vector.SyncVectorEnv([make] * count, autoreset_mode=autoreset))
    learner, memory = Learner(rng, [4, 32, 32, 2]), []
    observations, _ = env.reset(seed=seed)
    over = np.zeros(count, bool)
    for step in range(steps // count):
        eps = max(0.05, 1 - step / (steps / count / 2))
        q = forward(learner.online, observations)[1]
        actions = np.where(rng.random(count) < eps, rng.integers(2, size=count), q.argmax(1))
        recorder.acting(q_values=q, epsilon=eps)
        following, rewards, terminated, truncated, info = env.step(actions)
        for i in range(count):
            last = info["final_obs"][i] if "final_obs" in info and (terminated | truncated)[i] else following[i]
            if not (over[i] and mode == "NEXT_STEP" and mistake != "next_is_reset"):
                memory.append((observations[i], actions[i], rewards[i], last, terminated[i], truncated[i], GAMMA))
        over = terminated | truncated
        observations = following
        if mode == "DISABLED" and over.any():
            observations, _ = env.reset(options={"reset_mask": over})
        if len(memory) >= 100:
            batch = batch_of(memory, rng.integers(len(memory), size=32))
            y, loss = learner.update(batch)
            if step % 25 == 0:
                learner.target = [w.copy() for w in learner.online]
            recorder.learned(learner.online, learner.target, batch, y, loss)
    recorder.close()


# The mistakes, and the loops in which they can be seen.
MISTAKES = {
    "state_not_advanced": {}, "steps_after_the_end": {}, "truncation_ignored": {"limit": 20}, "same_start_every_episode": {},
    "time_limit_stored_as_terminated": {"limit": 20}, "terminated_never_stored": {},
    "next_is_current": {}, "next_is_reset": {"limit": 20}, "stored_action_is_another": {}, "reward_of_another_step": {},
    "observation_changed": {}, "row_that_never_happened": {}, "one_transition_repeated": {}, "samples_only_newest": {},
    "samples_only_oldest": {}, "memory_emptied": {"size": 8}, "memory_too_small": {},
    "never_explores": {}, "epsilon_never_falls": {}, "epsilon_falls_at_once": {}, "epsilon_grows": {}, "epsilon_not_applied": {},
    "epsilon_inverted": {}, "exploration_misses_an_action": {"task": "MountainCar-v0", "limit": 200}, "greedy_is_not_the_largest": {},
    "acts_on_an_old_observation": {},
    "target_never_updated": {}, "target_is_online": {}, "target_not_initialised": {"period": 150}, "tau_reversed": {"target": "soft"},
    "online_overwritten_by_target": {}, "target_updated_too_rarely": {},
    "online_never_changes": {}, "layer_never_changes": {}, "optimizer_made_anew": {}, "learns_at_episode_ends_only": {},
    "learns_before_a_batch_is_there": {}, "learns_while_evaluating": {}, "diverges": {"sgd": True, "rate": -0.05}, "units_die": {},
}  # fmt: skip

RIGHT = {
    "plain": {}, "optimizer given": {"optimizer": True}, "epsilon per episode": {"epsilon": "per_episode"},
    "epsilon of PyTorch's tutorial": {"epsilon": "slow"}, "constant epsilon": {"epsilon": "constant"}, "cycles": {"epsilon": "cycles"},
    "learns every 4 steps": {"every": 4, "period": 50}, "soft target": {"target": "soft"}, "target every 500 steps": {"period": 500},
    "small memory": {"capacity": 200}, "large batch": {"size": 128, "warm_up": 500}, "double": {"double": True}, "3 steps": {"n": 3},
    "10 steps, soft": {"n": 10, "target": "soft"}, "a wrapper's end": {"wrapper": Leaves}, "scaled rewards": {"scale": 0.01},
    "clipped rewards": {"clip": True}, "SGD": {"sgd": True, "rate": 0.01}, "nothing told": {"told": ()}, "epsilon told": {"told": ("epsilon",)},
    "Q-values told": {"told": ("q",)}, "limit 500": {"limit": 500}, "limit 20": {"limit": 20}, "Acrobot": {"task": "Acrobot-v1", "limit": 500},
    "MountainCar": {"task": "MountainCar-v0", "limit": 200}, "a high rate": {"rate": 0.1},
    "vector, next step": {"mode": "NEXT_STEP"}, "vector, same step": {"mode": "SAME_STEP"}, "vector, disabled": {"mode": "DISABLED"},
}  # fmt: skip


def record(path, mistake, settings, seed, steps):
    (vector_loop if "mode" in settings else loop)(path, mistake, seed, steps, **settings)


def judged(binary, path):
    """The names of the mistakes, and the whole verdict."""
    done = subprocess.run([binary, "check", path, "--json"], capture_output=True, text=True)
    if done.returncode not in (0, 1):
        sys.exit(f"FAILED: check ends with {done.returncode}: {done.stderr}")
    verdict = json.loads(done.stdout)
    names = [mistake["id"] for mistake in verdict["mistakes"]]
    if done.returncode != bool(names):
        sys.exit(f"FAILED: exit code {done.returncode} with the mistakes {names}")
    return names, verdict


def require(condition, message):
    if not condition:
        sys.exit(f"FAILED: {message}")


def nothing_raises_and_nothing_is_changed(directory):
    """Whatever the recorder is given, the loop goes on as without it."""
    said, sys.stderr = sys.stderr, io.StringIO()
    try:
        env = Recorder(f"{directory}/missing/x.trace", gama=1, gamma=object()).environment(gymnasium.make("CartPole-v1"))
        require(isinstance(env, gymnasium.Env) and env.unwrapped.gravity == 9.8, "the environment is another one")
        gymnasium.wrappers.RecordEpisodeStatistics(env).reset(seed=1)
        for wrong in (None, "x", object(), [1, "x"], np.ones((3, 0)), float("nan"), {}):
            recorder = Recorder(f"{directory}/wrong.trace")
            env = recorder.environment(gymnasium.make("CartPole-v1"))
            env.reset(seed=1)
            recorder.acting(wrong, wrong)
            env.step(0)
            for place in range(6):
                recorder.learned(*[wrong if place == other else None for other in range(6)])
                recorder.learned(*[wrong if place == other else [np.ones((4, 2)), np.ones(2)] for other in range(6)])
            recorder.close()
            recorder.learned(wrong)
            env.step(1)
        text = sys.stderr.getvalue()
        require(0 < len(text.splitlines()) < 60 and "Traceback" not in text, text)
    finally:
        sys.stderr = said
    # The same run with and without a recorder.
    ends = []
    for path in (f"{directory}/own.trace", None):
        np.random.seed(3)
        recorder = Recorder(path) if path else None
        env = gymnasium.make("CartPole-v1")
        env = recorder.environment(env) if path else env
        env.action_space.seed(5)
        learner, states = Learner(np.random.default_rng(1), [4, 8, 2]), [env.reset(seed=9)[0]]
        for step in range(300):
            said = env.step(env.action_space.sample())
            states.append(said[0] if not (said[2] or said[3]) else env.reset()[0])
            states[-1] += np.float32(0.25)  # An array that is changed in place is the user's business.
            batch = batch_of([(states[-2], 0, 1.0, states[-1], False, False, GAMMA)] * 4, range(4))
            copies = {name: array.copy() for name, array in batch.items()}
            y, loss = learner.update(batch)
            if recorder:
                recorder.learned(learner.online, learner.target, batch, y, loss)
            require(all((batch[name] == copies[name]).all() for name in batch), "a batch was changed")
        ends.append((np.random.random(), env.action_space.sample(), np.array(states).tobytes(), learner.online[0].tobytes()))
        if recorder:
            recorder.close()
    require(ends[0] == ends[1], "the run with a recorder is another one")
    print("nothing raises, and nothing is changed")


def networks_of_all_forms_are_the_same(directory):
    """A list, a tree as JAX has them, and a model as Keras has them leave the same file, apart from the names of their tensors."""

    class Model:
        def __init__(self, network):
            variable = lambda value: type("Variable", (), {"name": "v", "numpy": lambda self: value})()
            self.weights = self.trainable_variables = [variable(value) for value in network]

    tree = lambda network: {"params": {f"Dense_{i}": {"bias": network[2 * i + 1], "kernel": network[2 * i]} for i in range(12)}}
    files = []
    for form in (list, tree, Model):
        rng = np.random.default_rng(1)
        learner = Learner(rng, [4] * 12 + [2])
        recorder = Recorder(f"{directory}/form.trace", gamma=GAMMA, epsilon=1e-7, epsilon_place="tensorflow")
        for _ in range(40):
            row = lambda: (rng.normal(size=4), rng.integers(2), 1.0, rng.normal(size=4), False, False, GAMMA)
            batch = batch_of([row() for _ in range(8)], range(8))
            y, loss = learner.update(batch)
            recorder.learned(form(learner.online), form(learner.target), batch, y, loss)
        recorder._learning.names = []
        recorder.close()
        files.append(Path(f"{directory}/form.trace").read_bytes())
    require(files[0] == files[1] == files[2] and b"update.32.online.22.weight" in files[0], "the forms differ")
    print("networks of all forms are the same")


def networks_that_are_replaced_may_be_shared(binary, directory):
    """Where arrays never change, as in JAX, a copy is the same object; and without targets nothing says when the target network moved."""
    rng = np.random.default_rng(1)
    recorder = Recorder(f"{directory}/shared.trace", gamma=GAMMA)
    online = target = [rng.normal(size=shape).astype(np.float32) for shape in ((4, 8), (8,), (8, 2), (2,))]
    row = lambda: (rng.normal(size=4), rng.integers(2), 1.0, rng.normal(size=4), False, False, GAMMA)
    for update in range(130):
        online = [w + np.float32(0.01) for w in online]
        target = online if update % 32 == 0 else target
        recorder.learned(online, target, batch_of([row() for _ in range(8)], range(8)))
    recorder.close()
    names, _ = judged(binary, f"{directory}/shared.trace")
    file = Path(f"{directory}/shared.trace").read_bytes()
    require(not names and b"update.2." in file and b"update.32." not in file, f"a copy is accused: {names}")
    print("networks that are replaced may be shared")


def a_killed_loop_leaves_what_it_did(binary, directory):
    code = (
        f"import sys, os; sys.path[:0] = [{str(ROOT / 'tests/interop')!r}]; import recorder, gymnasium; r = recorder.Recorder('killed.trace'); "
        "env = r.environment(gymnasium.make('CartPole-v1')); env.reset(seed=1)\n"
        "while True:\n    if any(env.step(env.action_space.sample())[2:4]): env.reset()\n    if len(r._steps) == 3000: os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code], cwd=directory)
    names, verdict = judged(binary, f"{directory}/killed.trace")
    require(not names and any("after step 2000 is not in the file" in text for text in verdict["unseen"]), str(verdict))
    require(not list(Path(directory).glob("killed.trace.*")), "a temporary file is left")
    print("a killed loop leaves what it did")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", required=True)
    parser.add_argument("--steps", type=int, nargs="+", default=[1200])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--only", nargs="+", help="some of the mistakes or right loops")
    parser.add_argument("--keep", help="a directory for the traces")
    parser.add_argument("--table", action="store_true", help="print shares and go on where a verdict is not the expected one")
    arguments = parser.parse_args()
    binary = str(Path(arguments.binary).resolve())
    np.seterr(all="ignore")
    warnings.simplefilter("ignore")
    failures, named, right = [], {}, 0
    with tempfile.TemporaryDirectory() as directory:
        if not arguments.only and not arguments.table:
            nothing_raises_and_nothing_is_changed(directory)
            networks_of_all_forms_are_the_same(directory)
            networks_that_are_replaced_may_be_shared(binary, directory)
            a_killed_loop_leaves_what_it_did(binary, directory)
        for steps in arguments.steps:
            for name, settings in [*MISTAKES.items(), *RIGHT.items()]:
                if arguments.only and name not in arguments.only:
                    continue
                mistake = name if name in MISTAKES else ""
                for seed in range(arguments.seeds):
                    path = str(Path(arguments.keep or directory) / f"{name.replace(' ', '_')}.{steps}.{seed}.trace".replace("'", ""))
                    record(path, mistake, settings, seed, steps)
                    names, _ = judged(binary, path)
                    wrong = [other for other in names if other != mistake]
                    found = not mistake or mistake in names
                    named.setdefault((name, steps), []).append(found if mistake else not names)
                    if not found or (wrong and not mistake):
                        failures.append(f"{name}, {steps} steps, seed {seed}: {names}")
                    if arguments.table and wrong:
                        print(f"{name}, {steps} steps, seed {seed}: also {wrong}" if found else failures[-1], flush=True)
    for name in [*MISTAKES, *RIGHT]:
        shares = [named[name, steps] for steps in arguments.steps if (name, steps) in named]
        if shares:
            what = "named" if name in MISTAKES else "silent"
            print(f"{name:34}", *(f"{what} {sum(share)} of {len(share)}" for share in shares), sep="  ")
    print("\n".join(failures))
    if failures and not arguments.table:
        sys.exit("FAILED: these verdicts are not the expected ones")


if __name__ == "__main__":
    main()
