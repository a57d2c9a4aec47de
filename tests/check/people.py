"""tests/check/people.py --binary FILE: mistakes that people make, by the kinds of public threads, of the fault programs of DRLinter, of the faults that
RLExplorer looks for and of the mutants of μPRL, written anew in NumPy. Prints a table of what `cartpole-dqn check` says of each:
its right name; a fact that shows it; nothing; or something wrong.

Needs numpy and gymnasium."""

import argparse
import collections
import pathlib
import re
import sys
import tempfile
import warnings

import gymnasium
import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "interop"))
import recorder  # noqa: E402
from check_numpy import backward, forward  # noqa: E402
from planted import random_batch, save_update, verdict  # noqa: E402
from recorder import GAMMA, Learner, Recorder, batch_of  # noqa: E402

RATE = 1e-3


def layers(rng, sizes=(4, 24, 24, 2), scale=1.0):
    make = lambda i, o: (rng.uniform(-scale, scale, (i, o)) / i**0.5, rng.uniform(-scale, scale, o) / i**0.5)
    return [w.astype(np.float32) for i, o in zip(sizes, sizes[1:]) for w in make(i, o)]


def one_update(path, mistake, **settings):
    """One update with a mistake in targets, loss, gradients, optimiser or the forward pass; its batch is random numbers."""
    rng = np.random.default_rng(3)
    online, target, first = layers(rng), layers(rng), [w * np.float32(0.01) for w in layers(rng)]
    second, batch = [m * m + np.float32(1e-6) for m in first], random_batch(rng, 32, 4, 2)
    rows, actions, s, s2 = np.arange(32), batch["actions"], batch["observations"], batch["next_observations"]
    discounts = np.full(32, GAMMA, np.float32)
    if mistake in ("discount_of_one_step", "full_n_at_the_end", "discount_of_one_step_more"):
        steps = np.where(batch["terminated"] | batch["truncated"], rng.integers(1, 4, 32), 3)
        discounts = batch["discounts"] = (GAMMA**steps).astype(np.float32)
    used = {"discount_of_one_step": GAMMA, "full_n_at_the_end": GAMMA**3, "discount_of_one_step_more": discounts * GAMMA, "discount_forgotten": 1.0,
            "discount_twice": GAMMA**2}.get(mistake, discounts)  # fmt: skip
    activations = {
        "hidden_tanh": (np.tanh, None), "output_relu": (None, lambda q: np.maximum(q, 0)), "output_sigmoid": (None, lambda q: 1 / (1 + np.exp(-q))),
        "output_softmax": (None, lambda q: np.exp(q) / np.exp(q).sum(1, keepdims=True)), "dueling_mean_over_batch": (None, lambda q: q + (q.sum(1) ** 2 - (q.sum(1) ** 2).mean())[:, None]),
    }.get(mistake, (None, None))  # fmt: skip

    def values(network, x):
        for layer in range(0, 6, 2):
            x = x @ network[layer] + network[layer + 1]
            if layer < 4:
                x = (activations[0] or (lambda z: np.maximum(z, 0)))(x)
        return activations[1](x) if activations[1] else x

    q2 = values(online if mistake in ("bootstrap_from_online",) else target, s if mistake == "current_observation" else s2)
    best = values(online, s2).argmax(1) if settings.get("double") else q2.argmax(1)
    following = {
        "next_value_of_taken_action": q2[rows, actions], "index_in_place_of_value": q2.argmax(1), "maximum_of_batch": q2.max(),
        "double_left_out": q2.max(1), "double_exchanged": values(online, s2)[rows, q2.argmax(1)], "next_value_minimum": q2.min(1),
    }.get(mistake, q2[rows, best])  # fmt: skip
    mask = 1 - batch["terminated"].astype(np.float32)
    mask = {"terminal_bootstrapped": np.ones(32), "truncation_not_bootstrapped": mask * ~batch["truncated"], "mask_inverted": 1 - mask}.get(mistake, mask)
    rewards = {"reward_negated": -batch["rewards"], "reward_clipped": batch["rewards"].clip(-1, 1), "reward_forgotten": 0}.get(mistake, batch["rewards"])
    y = (rewards + used * mask * following).astype(np.float32)
    if mistake == "terminal_reward_lost":
        y = y * mask
    if mistake == "wrong update rule":
        y = (np.where(batch["terminated"], rewards, GAMMA * (rewards - following))).astype(np.float32)
    results = {"targets": y, "q": values(online, s)}
    if mistake == "targets_of_every_pair":
        results["targets"] = batch["rewards"][:, None] + (GAMMA * mask * following)[None, :]
    if activations != (None, None):
        return save(path, online, target, (20, first, second), batch, results, settings)
    inputs, q = forward(online, s)
    chosen, weight = q[rows, actions], np.float32(2 / 32)
    error = chosen - y
    dq = np.zeros_like(q)
    if mistake == "targets_of_every_pair":
        error = chosen[None, :] - results["targets"]
        dq[rows, actions], results["loss"] = 2 * error.sum(0) / 32**2, (error**2).mean()
    elif mistake == "every_pair":
        dq[rows, actions], results["loss"] = weight * (chosen - y.mean()), ((chosen[:, None] - y) ** 2).mean()
    elif mistake == "mean_over_outputs":
        dq[rows, actions], results["loss"] = weight / 2 * error, (error**2).mean() / 2
    elif mistake == "sum":
        dq[rows, actions], results["loss"] = 2 * error, (error**2).sum()
    elif mistake == "clipped_square":
        dq[rows, actions] = weight * error * (np.abs(error) < 1)
        results["loss"] = (error.clip(-1, 1) ** 2).mean()
    elif mistake == "full_target_zeros":
        full = np.zeros_like(q)
        full[rows, actions] = y
        dq, results["loss"] = 2 * (q - full) / q.size, ((q - full) ** 2).mean()
    elif mistake == "every_column":
        full = q[:, actions] - y
        np.add.at(dq.T, actions, (2 * full / full.size).T)
        results["loss"] = (full**2).mean()
    else:
        dq[rows, (actions + (mistake == "gradient_of_wrong_action")) % 2], results["loss"] = weight * error, (error**2).mean()
    gradients = backward(online, inputs, dq.astype(np.float32))
    if mistake == "gradient_through_target":
        inputs2, d2 = forward(online, s2)[0], np.zeros_like(q)
        q2 = forward(online, s2)[1]
        results["targets"] = y = (batch["rewards"] + GAMMA * mask * q2.max(1)).astype(np.float32)
        error = chosen - y
        dq[rows, actions], d2[rows, q2.argmax(1)] = weight * error, -weight * error * GAMMA * mask
        gradients = [a + b for a, b in zip(backward(online, inputs, dq), backward(online, inputs2, d2.astype(np.float32)))]
        results["loss"], target = (error**2).mean(), None
    if mistake == "gradient_accumulated":
        settings = {**settings, "before": [g * np.float32(0.7) for g in first]}
        gradients = [g + b for g, b in zip(gradients, settings["before"])]
    norm = np.sqrt(sum((g**2).sum() for g in gradients))
    if "max_gradient_norm" in settings and mistake != "gradient_not_clipped":
        gradients = [g * min(1, settings["max_gradient_norm"] / (norm + 1e-6)) for g in gradients]
    steps = {"step_count_behind": 20}.get(mistake, 21)
    after = []
    for w, g, m, v in zip(online, gradients, first, second):
        m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g * g
        step = m / (1 - 0.9**steps) / (np.sqrt(v / (1 - 0.999**steps)) + 1e-8)
        step = {"ascent": -step, "no_step": 0 * step, "sgd": g}.get(mistake, step)
        after.append((w - RATE * step).astype(np.float32))
    results |= {"gradients": gradients, "online": after}
    save(path, online, target, (20, first, second), batch, results, settings)


def save(path, online, target, adam, batch, results, settings):
    settings = dict(settings)
    before = settings.pop("before", None)
    save_update(path, online, target, adam, batch, results, gamma=GAMMA, learning_rate=RATE, **settings)
    if before is not None:  # As a module of PyTorch would have shown.
        sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "python"))
        from cartpole_dqn import _tensors, tensors
        from cartpole_dqn._update import _network

        file = tensors(path)
        import json

        with open(path, "rb") as opened:
            metadata = json.loads(opened.read(int.from_bytes(opened.read(8), "little")))["__metadata__"]
        _tensors.write(path, {**file, **_network("before.gradients", before)}, metadata)


def one_batch(path, mistake):
    """A right update of a batch of CartPole-v1 that is wrong."""
    rng, env = np.random.default_rng(4), gymnasium.make("CartPole-v1", max_episode_steps=25)
    memory, observation = [], env.reset(seed=1)[0]
    start = observation
    while len(memory) < 600:
        action = int(rng.integers(2))
        following, reward, terminated, truncated, _ = env.step(action)
        ended = terminated or truncated
        fresh = env.reset()[0] if ended else following
        s = start if mistake == "state_not_advanced" else observation
        s2 = {"next_is_current": observation, "next_is_reset": fresh}.get(mistake, following)
        stored = int(rng.integers(2)) if mistake == "stored_action_is_another" else action
        end = {"terminated_never_stored": False, "time_limit_stored_as_terminated": ended}.get(mistake, terminated)
        reward, end = (float(end), bool(reward)) if mistake == "reward_and_end_exchanged" else (reward, end)
        memory.append((s, stored, reward, s2, end, truncated and mistake != "time_limit_stored_as_terminated", GAMMA))
        if mistake == "observations_rounded":
            memory[-1] = (np.round(s), stored, reward, np.round(s2), *memory[-1][4:])
        observation = fresh
        start = fresh if ended else start
    chosen = rng.choice(600, 64, replace=False)
    if mistake == "one_transition_repeated":
        chosen[:] = chosen[0]
    batch = batch_of(memory, chosen)
    if mistake == "row_that_never_happened":
        batch["next_observations"] = batch["next_observations"][rng.permutation(64)]
    if not batch["truncated"].any():
        del batch["truncated"]
    discounts = batch.pop("discounts")
    online, target = layers(rng), layers(rng)
    y = batch["rewards"] + discounts * (1 - batch["terminated"]) * forward(target, batch["next_observations"])[1].max(1)
    save_update(path, online, target, None, batch, {"targets": y.astype(np.float32)}, gamma=GAMMA)


def looped(path, epsilon=None, sync=None, choose=None, observe=None, every=1, steps=1500, rate=2e-3, limit=100, warm_up=100, gamma=GAMMA, init=None):
    """A loop that is right but for what is given."""
    rng, told = np.random.default_rng(5), Recorder(path, gamma=GAMMA, learning_rate=rate)
    env = told.environment(gymnasium.make("CartPole-v1", max_episode_steps=limit))
    learner, memory, episode, observation = Learner(rng, [4, 32, 32, 2], rate), [], 0, env.reset(seed=2)[0]
    if init:
        init(learner)
    for step in range(steps):
        eps = epsilon(step, episode) if epsilon else max(0.05, 1 - step / 750)
        q = forward(learner.online, observation[None])[1][0]
        action = int(rng.integers(2)) if rng.random() < eps else int(q.argmax())
        action = choose(q, action, step) if choose else action
        told.acting(q, eps)
        following, reward, terminated, truncated, _ = env.step(action)
        memory.append((observation, action, reward, following, terminated, truncated, gamma))
        observation = following
        if terminated or truncated:
            episode, observation = episode + 1, env.reset()[0]
        if step >= warm_up and step % every == 0:
            batch = batch_of(memory, rng.integers(len(memory), size=32))
            y, loss = learner.update(batch)
            if sync:
                sync(learner, step, episode)
            elif step % 100 == 0:
                learner.target = [w.copy() for w in learner.online]
            told.learned(learner.online, learner.target, batch, y, loss)
    told.close()


def online_moves_to_target(learner, step, _):
    for w, t in zip(learner.online, learner.target):
        w += np.float32(0.05) * (t - w)


def both_exchanged(learner, step, _):
    if step % 100 == 0:
        learner.online, learner.target = learner.target, learner.online


def copies(period):
    def sync(learner, step, _):
        if step % period == 0:
            learner.target = [w.copy() for w in learner.online]

    return sync


def constant(learner):
    for w in (*learner.online, *learner.target):
        w[:] = 0


def loop(mistake, **given):
    settings = {**recorder.MISTAKES[mistake], **given}
    steps = settings.pop("steps", 1500)
    return lambda path: recorder.record(path, mistake, settings, 0, steps)


update = lambda mistake, **settings: lambda path: one_update(path, mistake, **settings)
batch = lambda mistake: lambda path: one_batch(path, mistake)
own = lambda **given: lambda path: looped(path, **given)
THREADS, LINTER, EXPLORER, MUTANTS = "threads", "DRLinter", "RLExplorer", "μPRL"
# Where from, its kind, what is done, how, its names, and a fact that would show it.
CASES = [
    *((THREADS, "targets, loss, gradient, optimiser", name, update(name, **given), {name}, None) for name, given in [
        ("terminal_bootstrapped", {}), ("truncation_not_bootstrapped", {}), ("mask_inverted", {}), ("terminal_reward_lost", {}), ("bootstrap_from_online", {}),
        ("double_exchanged", {"double": True}), ("double_left_out", {"double": True}), ("current_observation", {}), ("next_value_of_taken_action", {}),
        ("index_in_place_of_value", {}), ("maximum_of_batch", {}), ("discount_forgotten", {}), ("discount_of_one_step", {}), ("full_n_at_the_end", {}),
        ("reward_negated", {}), ("targets_of_every_pair", {}), ("every_pair", {}), ("every_column", {}), ("mean_over_outputs", {}), ("full_target_zeros", {}),
        ("clipped_square", {}), ("gradient_through_target", {}), ("gradient_accumulated", {}), ("gradient_not_clipped", {"max_gradient_norm": 0.05}),
        ("ascent", {}), ("no_step", {}),
    ]),
    *((THREADS, "forward pass", name, update(name), {name}, None) for name in ("output_relu", "output_softmax", "output_sigmoid", "hidden_tanh", "dueling_mean_over_batch")),
    *((THREADS, "batch", name, batch(name), {name}, None) for name in (
        "one_transition_repeated", "next_is_current", "state_not_advanced", "next_is_reset", "stored_action_is_another", "reward_and_end_exchanged",
        "terminated_never_stored", "time_limit_stored_as_terminated", "observations_rounded")),
    (THREADS, "exploration", "ε · 0.97 at each step, meant for each episode", own(epsilon=lambda step, _: max(0.05, 0.97**step)), {"epsilon_falls_at_once"}, "ε 1.00 to 0.05"),
    (THREADS, "exploration", "the formula is at its end at once", own(epsilon=lambda step, _: 0.05 + 0.95 * np.exp(-step)), {"epsilon_falls_at_once"}, r"ε [\d.]+ to 0.05"),
    (THREADS, "exploration", "integer division: ε is 0 after the first step", own(epsilon=lambda step, _: float(step == 0)), {"epsilon_falls_at_once", "never_explores"}, "ε"),
    (THREADS, "exploration", "epsilon_never_falls", loop("epsilon_never_falls"), {"epsilon_never_falls"}, None),
    (THREADS, "exploration", "epsilon_grows", loop("epsilon_grows"), {"epsilon_grows"}, None),
    (THREADS, "exploration", "min(ε · 0.999, 0.05) for max", own(epsilon=lambda step, _: 1.0 if step == 0 else 0.05), {"epsilon_falls_at_once"}, "ε"),
    (THREADS, "exploration", "epsilon_not_applied", loop("epsilon_not_applied"), {"epsilon_not_applied"}, None),
    (THREADS, "exploration", "epsilon_inverted", loop("epsilon_inverted"), {"epsilon_inverted"}, None),
    (THREADS, "exploration", "exploration_misses_an_action", loop("exploration_misses_an_action"), {"exploration_misses_an_action"}, None),
    (THREADS, "target network", "target_never_updated", loop("target_never_updated"), {"target_never_updated"}, None),
    (THREADS, "target network", "target_is_online", loop("target_is_online"), {"target_is_online"}, None),
    (THREADS, "target network", "a soft update of 0.005 once in some episodes", loop("target_updated_too_rarely"), {"target_updated_too_rarely"}, None),
    (THREADS, "target network", "target_not_initialised", loop("target_not_initialised"), {"target_not_initialised"}, None),
    (THREADS, "target network", "copied into the online network", loop("online_overwritten_by_target"), {"online_overwritten_by_target"}, None),
    (THREADS, "target network", "soft update into the online network", own(sync=online_moves_to_target), {"online_overwritten_by_target", "target_never_updated"}, "target network did not change"),
    (THREADS, "target network", "the two networks are exchanged", own(sync=both_exchanged), {"online_overwritten_by_target"}, "target network (copied|changes)"),
    (THREADS, "when it learns", "learns_at_episode_ends_only", loop("learns_at_episode_ends_only"), {"learns_at_episode_ends_only"}, None),
    (THREADS, "when it learns", "learns_before_a_batch_is_there", loop("learns_before_a_batch_is_there"), {"learns_before_a_batch_is_there"}, None),
    (THREADS, "when it learns", "learns_while_evaluating", loop("learns_while_evaluating"), {"learns_while_evaluating"}, None),
    (THREADS, "ends and evaluation", "truncation_ignored", loop("truncation_ignored"), {"truncation_ignored"}, None),
    (THREADS, "ends and evaluation", "evaluated with ε 0.1", own(epsilon=lambda step, _: 0.1 if step > 1200 else max(0.1, 1 - step / 700)), set(), "ε .* 0.10 at the end"),
    (THREADS, "ends and evaluation", "learns and forgets (rate 0.05)", own(rate=0.05), set(), "mean return"),
    (LINTER, "missing exploration", "always the greedy action", loop("never_explores"), {"never_explores"}, None),
    (LINTER, "suboptimal exploration rate", "ε falls at once", loop("epsilon_falls_at_once"), {"epsilon_falls_at_once"}, None),
    (LINTER, "suboptimal exploration rate, 2", "ε is divided by its decay, and grows", own(epsilon=lambda step, episode: max(0.1, 0.9 / 0.999**episode)), {"epsilon_grows", "epsilon_never_falls"}, "ε"),
    (LINTER, "missing stepping", "env.step is never called", lambda path: no_step(path), set(), None),
    (LINTER, "missing stepping the environment", "the observation is never that of env.step", loop("state_not_advanced"), {"state_not_advanced"}, None),
    (LINTER, "missing reset, missing close", "no env.reset at an end", loop("steps_after_the_end"), {"steps_after_the_end"}, None),
    (LINTER, "missing terminal state", "the end is not looked at", loop("terminated_never_stored"), {"terminated_never_stored"}, None),
    (LINTER, "suboptimal network update frequency", "a copy every 2 updates", own(sync=copies(2)), {"target_is_online"}, "copied every 2 updates"),
    (LINTER, "wrong activation of the output", "softmax", update("output_softmax"), {"output_softmax"}, None),
    (LINTER, "wrong activation of the output, 2", "ReLU", update("output_relu"), {"output_relu"}, None),
    (LINTER, "wrong initialisation", "all weights 0", own(init=constant), {"units_die", "layer_never_changes", "online_never_changes"}, "hidden units are 0"),
    (LINTER, "wrong network update", "copied into the online network", loop("online_overwritten_by_target"), {"online_overwritten_by_target"}, None),
    (LINTER, "wrong network update, 2", "no copy at all", loop("target_never_updated"), {"target_never_updated"}, None),
    (LINTER, "wrong output", "max for argmax: the action is a Q-value", own(choose=lambda q, action, step: int(np.clip(int(q.max()), 0, 1)) if step > 400 else action), {"greedy_is_not_the_largest"}, "chosen"),
    (LINTER, "wrong update rule", "γ (r − max Q⁻)", update("wrong update rule"), set(), None),
    (LINTER, "clean", "the program without a fault", own(), set(), None),
    (EXPLORER, "exploration", "falls too fast", loop("epsilon_falls_at_once"), {"epsilon_falls_at_once"}, None),
    (EXPLORER, "exploration", "does not fall", loop("epsilon_never_falls"), {"epsilon_never_falls"}, None),
    (EXPLORER, "actions", "the same action for ever", own(epsilon=lambda *_: 0.0, choose=lambda *_: 1), {"never_explores", "greedy_is_not_the_largest"}, "action 0 is never"),
    (EXPLORER, "states", "the state does not change", loop("state_not_advanced"), {"state_not_advanced"}, None),
    (EXPLORER, "target network", "never updated", loop("target_never_updated"), {"target_never_updated"}, None),
    (EXPLORER, "target network", "updated at each step", own(sync=copies(1)), {"target_is_online"}, "copied every update"),
    (EXPLORER, "loss", "diverges", loop("diverges"), {"diverges"}, None),
    (EXPLORER, "weights", "do not change", loop("online_never_changes"), {"online_never_changes"}, None),
    (EXPLORER, "weights", "a layer does not change", loop("layer_never_changes"), {"layer_never_changes"}, None),
    (EXPLORER, "activations", "dead ReLU", loop("units_die"), {"units_die"}, None),
    (EXPLORER, "Q-values", "a wrong mask", update("terminal_bootstrapped"), {"terminal_bootstrapped"}, None),
    (EXPLORER, "steps", "episodes do not end", loop("steps_after_the_end"), {"steps_after_the_end"}, None),
    (MUTANTS, "final ε", "0.8 at the end", own(epsilon=lambda step, _: max(0.8, 1 - step / 1000)), {"epsilon_never_falls"}, "ε 1.00 to 0.80"),
    (MUTANTS, "γ", "0.5 for 0.98", own(gamma=0.5), {"another_discount"}, "γ"),
    (MUTANTS, "learning starts", "at nine tenths of the run", own(warm_up=1350), set(), "the first after 1,35"),
    (MUTANTS, "steps", "a tenth of them", own(steps=300), set(), "300 steps"),
    (MUTANTS, "target update interval", "1", own(sync=copies(1)), {"target_is_online"}, "copied every update"),
    (MUTANTS, "target update interval", "longer than the run", loop("target_never_updated"), {"target_never_updated"}, None),
]  # fmt: skip


def no_step(path):
    """The program that never calls env.step."""
    rng, told = np.random.default_rng(5), Recorder(path, gamma=GAMMA)
    env = told.environment(gymnasium.make("CartPole-v1"))
    learner, observation = Learner(rng, [4, 32, 32, 2]), env.reset(seed=2)[0]
    memory = [(observation, 0, 0.0, observation, False, False, GAMMA)] * 50
    for step in range(300):
        chosen = batch_of(memory, rng.integers(len(memory), size=32))
        y, loss = learner.update(chosen)
        told.learned(learner.online, learner.target, chosen, y, loss)
    told.close()


def said(binary, path):
    _, found = verdict(binary, path)
    if "mistakes" in found:
        return [{mistake["id"]} for mistake in found["mistakes"]], found["facts"], found["unseen"]
    mistakes = [*(mistake for one in found["explanations"] for mistake in one), *found["batch"]["mistakes"]]
    states = [f"{q['name']} {q['state']}" for q in found["quantities"]]
    return [{mistake["id"]} for mistake in mistakes], found["facts"] + found["batch"]["facts"], states + found["unseen"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", required=True)
    parser.add_argument("--only", help="cases of which the line has this")
    arguments = parser.parse_args()
    np.seterr(all="ignore")
    warnings.simplefilter("ignore")
    counts = collections.defaultdict(collections.Counter)
    print("| from | kind | what is done | what `check` says |\n| --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as directory:
        for source, kind, what, make, right, fact in CASES:
            if arguments.only and arguments.only not in f"{source} {kind} {what}":
                continue
            path = f"{directory}/one"
            make(path)
            sets, facts, unseen = said(arguments.binary, path)
            names = set().union(*sets)
            shown = [text for text in (*facts, *map(str, unseen)) if fact and re.search(fact, text)]
            if names & right or (kind == "clean" and not names):
                answer, text = "named", ", ".join(f"`{name}`" for name in sorted(names)) or "nothing is wrong"
            elif names:
                answer, text = "wrong", f"WRONG: {', '.join(sorted(names))}"
            elif shown:
                answer, text = "fact", f"fact: {shown[0]}"
            else:
                answer, text = "nothing", f"nothing ({'; '.join(map(str, unseen))[:160]})"
            counts[source][answer] += 1
            counts[f"{source}: {kind}"][answer] += 1
            print(f"| {source} | {kind} | {what} | {text} |", flush=True)
    print("\n| | named | fact | nothing | wrong |\n| --- | --- | --- | --- | --- |")
    for source, one in counts.items():
        if ":" not in source or source.startswith(THREADS):
            print(f"| {source} | {one['named']} | {one['fact']} | {one['nothing']} | {one['wrong']} |")


if __name__ == "__main__":
    main()
