"""tests/check/torch_matrix.py --binary FILE [--write docs/results/check.md]: plants every mistake of the catalogue and 20
pairs of them in a DQN update in PyTorch, computes 200 right updates of all sizes, and holds `cartpole-dqn check` to them.

Needs torch and numpy."""

import argparse
import itertools
import pathlib
import sys
import tempfile

import numpy as np
import torch
from torch import nn

from planted import explained, random_batch, save_update, verdict



def network(sizes, dtype):
    layers = []
    for inputs, outputs in itertools.pairwise(sizes):
        layers += [nn.Linear(inputs, outputs, dtype=dtype), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


class Learner:
    """Networks that have learned a little, and an update with mistakes."""

    def __init__(self, seed, sizes, size, dtype, *, double=False, loss="mse", norm=None, has_target=True, steps=3, gamma=0.9):
        torch.manual_seed(seed)
        self.rng = np.random.default_rng(seed)
        self.dtype, self.double, self.loss, self.norm, self.gamma = dtype, double, loss, norm, gamma
        self.online, self.target = network(sizes, dtype), network(sizes, dtype) if has_target else None
        self.learning_rate = 3e-3
        self.optimizer = torch.optim.Adam(self.online.parameters(), lr=self.learning_rate, eps=1e-8)
        self.sizes, self.size = sizes, size
        for _ in range(steps):
            self.update(self.batch(), ())
            self.before = [p.grad.clone() for p in self.online.parameters()]

    def batch(self):
        floats = np.float32 if self.dtype == torch.float32 else np.float64
        batch = random_batch(self.rng, self.size, self.sizes[0], self.sizes[-1], floats)
        return {name: torch.as_tensor(value) for name, value in batch.items()}

    def save(self, path, mistakes):
        batch = self.batch()
        settings = dict(gamma=self.gamma, loss=self.loss, double=self.double, learning_rate=self.learning_rate)
        settings |= {"max_gradient_norm": self.norm} if self.norm else {}
        save_update(path, self.online, self.target, self.optimizer, batch, lambda: self.update(batch, mistakes), **settings)

    def targets(self, batch, has):
        s, s2, a, r = (batch[k] for k in ("observations", "next_observations", "actions", "rewards"))
        d, cut = batch["terminated"].to(self.dtype), batch["truncated"].to(self.dtype)
        if has("current_observation"):
            s2 = s
        target = self.target if self.target is not None and not has("bootstrap_from_online") else self.online
        q, q_online = target(s2), self.online(s2)
        double = (self.double and not has("double_left_out")) or has("double_unasked")
        if has("double_exchanged"):
            following = q_online.gather(1, q.argmax(1)[:, None])[:, 0]
        elif has("next_value_of_taken_action"):
            following = q.gather(1, a[:, None])[:, 0]
        elif has("next_value_mean"):
            following = q.mean(1)
        elif has("next_value_minimum"):
            following = q.min(1)[0]
        elif has("index_in_place_of_value"):
            following = q.max(1)[1]
        elif has("maximum_of_batch"):
            following = q.max()
        elif double:
            following = q.gather(1, q_online.argmax(1)[:, None])[:, 0]
        else:
            following = q.max(1)[0]
        gamma = 1.0 if has("discount_forgotten") else self.gamma**2 if has("discount_twice") else self.gamma
        mask = 1 - d
        if has("terminal_bootstrapped"):
            mask = torch.ones_like(d)
        if has("truncation_not_bootstrapped"):
            mask = (1 - d) * (1 - cut)
        if has("mask_inverted"):
            mask = d
        if has("reward_forgotten"):
            r = torch.zeros_like(r)
        if has("reward_clipped"):
            r = r.clamp(-1, 1)
        if has("reward_discounted"):
            r = gamma * r
        if has("terminal_reward_lost"):
            return mask * (r + gamma * following)
        return r + gamma * mask * following

    def update(self, batch, mistakes):
        has = lambda name: name in mistakes
        y = self.targets(batch, has)
        y = y if has("gradient_through_target") else y.detach()
        q_all = self.online(batch["observations"])
        actions = batch["actions"]
        if has("other_action_predicted"):
            actions = (actions + 1) % q_all.shape[1]
        q = q_all.max(1)[0] if has("largest_predicted") else q_all.gather(1, actions[:, None])[:, 0]
        if has("gradient_of_wrong_action"):
            wrong = q_all.gather(1, ((actions + 1) % q_all.shape[1])[:, None])[:, 0]
            q = q.detach() + wrong - wrong.detach()
        if has("gradient_of_all_actions"):
            q = q.detach() + q_all.sum(1) - q_all.sum(1).detach()
        compared, goal = q, y
        if has("every_output"):
            compared, goal = q_all, y[:, None].expand_as(q_all)
        if has("every_pair"):
            compared, goal = q[:, None].expand(-1, len(q)), y[None, :].expand(len(q), -1)
        huber = (self.loss == "huber" and not has("mse_for_huber")) or has("huber_for_mse")
        penalty = nn.functional.smooth_l1_loss if huber else nn.functional.mse_loss
        penalty = nn.functional.l1_loss if has("absolute_error") else penalty
        loss = penalty(compared, goal, reduction="sum" if has("sum") else "mean")
        if has("half_square"):
            loss = loss / 2
        if has("mean_over_outputs"):
            full = q_all.detach().clone()
            full[torch.arange(len(q)), actions] = y.detach()
            loss = penalty(q_all, full) if not has("sum") else loss / q_all.shape[1]
        if not has("gradient_accumulated"):
            self.optimizer.zero_grad()
        loss.backward()
        parameters = list(self.online.parameters())
        if has("gradient_clipped_by_value"):
            nn.utils.clip_grad_value_(parameters, self.norm or 1.0)
        elif has("gradient_clipped_by_tensor"):
            for parameter in parameters:
                nn.utils.clip_grad_norm_([parameter], self.norm)
        elif self.norm and not has("gradient_not_clipped"):
            nn.utils.clip_grad_norm_(parameters, self.norm)
        self.step(parameters, has)
        return y.detach(), loss.detach()

    @torch.no_grad()
    def step(self, parameters, has):
        planted = ("adam_uncorrected", "adam_epsilon_of_keras", "rmsprop", "ascent", "sgd", "no_step", "weight_decay_of_optax",
                   "adam_epsilon_1e-7", "weight_decay", "weight_decay_in_gradient", "step_count_behind", "step_count_ahead")
        if not any(map(has, planted)):
            return self.optimizer.step()
        lr, eps = self.learning_rate, 1e-7 if has("adam_epsilon_1e-7") else 1e-8
        for p in parameters:
            state = self.optimizer.state[p]
            zero = torch.zeros_like(p)
            t, m, v = int(state.get("step", 0)) + 1, state.get("exp_avg", zero), state.get("exp_avg_sq", zero)
            t += has("step_count_ahead") - has("step_count_behind")
            g = p.grad + 0.01 * p if has("weight_decay_in_gradient") else p.grad
            m, v, old_v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g * g, v
            step = m / (1 - 0.9**t) / ((v / (1 - 0.999**t)).sqrt() + eps)
            if has("adam_uncorrected"):
                step = m / (v.sqrt() + eps)
            if has("adam_epsilon_of_keras"):
                step = (1 - 0.999**t) ** 0.5 / (1 - 0.9**t) * m / (v.sqrt() + eps)
            if has("rmsprop"):
                step = g / ((0.99 * old_v + 0.01 * g * g).sqrt() + eps)
            step = g if has("sgd") else -step if has("ascent") else 0 * step if has("no_step") else step
            decay = 0.01 if has("weight_decay") else 0.0001 if has("weight_decay_of_optax") else 0.0
            p.copy_(p * (1 - lr * decay) - lr * step)


# The mistakes in the order of the catalogue, with what an update needs so that they show.
DOUBLE, NORM, HUBER, ALONE, SECOND = {"double": True}, {"norm": 0.05}, {"loss": "huber"}, {"has_target": False}, {"steps": 1}
MISTAKES = {
    "terminal_bootstrapped": {}, "truncation_not_bootstrapped": {}, "mask_inverted": {}, "terminal_reward_lost": {},
    "bootstrap_from_online": {}, "double_exchanged": DOUBLE, "double_left_out": DOUBLE, "double_unasked": {},
    "current_observation": {}, "next_value_of_taken_action": {}, "next_value_mean": {}, "next_value_minimum": {},
    "index_in_place_of_value": {}, "maximum_of_batch": {}, "discount_forgotten": {}, "discount_twice": {},
    "reward_discounted": {}, "reward_forgotten": {}, "reward_clipped": {},
    "sum": {}, "mean_over_outputs": {}, "half_square": {}, "huber_for_mse": {}, "mse_for_huber": HUBER, "absolute_error": {},
    "every_pair": {}, "every_output": {}, "largest_predicted": {}, "other_action_predicted": {},
    "gradient_through_target": ALONE, "gradient_of_wrong_action": {}, "gradient_of_all_actions": {},
    "gradient_accumulated": SECOND, "gradient_not_clipped": NORM, "gradient_clipped_by_value": NORM,
    "gradient_clipped_by_tensor": NORM,
    "adam_uncorrected": {}, "adam_epsilon_of_keras": {}, "adam_epsilon_1e-7": {}, "weight_decay": {},
    "weight_decay_of_optax": {}, "weight_decay_in_gradient": {}, "sgd": {}, "rmsprop": {}, "step_count_behind": {},
    "step_count_ahead": {}, "ascent": {}, "no_step": {},
}
# In two different quantities, and in the same one.
PAIRS = [
    ("terminal_bootstrapped", "sum"), ("terminal_bootstrapped", "weight_decay"), ("truncation_not_bootstrapped", "every_pair"),
    ("mask_inverted", "huber_for_mse"), ("bootstrap_from_online", "gradient_through_target"), ("double_exchanged", "half_square"),
    ("double_left_out", "adam_uncorrected"), ("current_observation", "gradient_of_all_actions"),
    ("next_value_of_taken_action", "sgd"), ("discount_forgotten", "absolute_error"), ("discount_twice", "step_count_ahead"),
    ("reward_forgotten", "largest_predicted"), ("mean_over_outputs", "gradient_clipped_by_value"),
    ("sum", "gradient_not_clipped"), ("gradient_not_clipped", "ascent"), ("every_output", "rmsprop"),
    ("terminal_bootstrapped", "bootstrap_from_online"), ("discount_twice", "current_observation"), ("sum", "huber_for_mse"),
    ("weight_decay", "step_count_behind"),
]
OTHERS = "\n## Every optimiser and setting"
F32, F64 = torch.float32, torch.float64


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--binary", required=True)
    parser.add_argument("--write", type=pathlib.Path)
    arguments = parser.parse_args()
    path = str(pathlib.Path(tempfile.mkdtemp()) / "update.safetensors")
    wrong, rows = 0, []
    for mistakes in [(name,) for name in MISTAKES] + PAIRS:
        needs = {}
        for name in mistakes:
            needs |= MISTAKES[name]
        if "bootstrap_from_online" in mistakes:
            needs.pop("has_target", None)
        row = [" + ".join(mistakes)]
        for dtype, sizes in [(F64, (4, 24, 24, 2)), (F32, (4, 24, 24, 2)), (F32, (6, 64, 64, 3))]:
            Learner(len(rows), sizes, 32, dtype, **needs).save(path, mistakes)
            code, found = verdict(arguments.binary, path)
            sets = explained(found)
            hidden = [name for name in mistakes if name.replace("_", " ") in found["not_visible"]]
            hidden = [] if frozenset(mistakes) in sets else hidden
            visible = frozenset(mistakes) - frozenset(hidden)
            right = visible in sets if visible else code == 0
            others = [" + ".join(sorted(s)) for s in sets if s != visible]
            wrong += not right
            said = ["right"] if visible else []
            said += [f"or {other}" for other in others] + [f"{name} not visible" for name in hidden]
            row.append(", ".join(said) if right else f"WRONG: {[sorted(s) for s in sets]}")
        rows.append(row)
        print("  ".join(row), flush=True)
    rng = np.random.default_rng(1)
    alarms = 0
    for seed in range(200):
        hidden = [int(h) for h in rng.choice([1, 8, 24, 64, 128, 256], size=rng.integers(0, 4))]
        sizes = (4, 256, 256, 2) if seed % 10 == 0 else (int(rng.integers(1, 9)), *hidden, int(rng.integers(1, 7)))
        size = 256 if seed % 10 == 0 else int(rng.choice([1, 2, 7, 32, 64, 256]))
        options = dict(double=bool(rng.integers(2)), loss=str(rng.choice(["mse", "huber"])), norm=[None, 0.05, 1.0][rng.integers(3)],
                       has_target=bool(rng.integers(4)), steps=int(rng.choice([0, 1, 10, 100])), gamma=float(rng.choice([0.9, 0.99, 1.0])))
        Learner(seed, sizes, size, (F32, F64)[seed % 2], **options).save(path, ())
        code, found = verdict(arguments.binary, path)
        if code != 0:
            alarms += 1
            print("FALSE ALARM", seed, sizes, size, options, [(q["name"], q["state"], q["largest_relative_difference"]) for q in found["quantities"]], flush=True)
    print(f"{wrong} wrong verdicts, {alarms} false alarms in 200 right updates")
    if arguments.write:
        # What other scripts have found stands behind this heading.
        text = arguments.write.read_text() if arguments.write.exists() else ""
        arguments.write.write_text(page(rows, alarms) + text[text.find(OTHERS) :] if OTHERS in text else page(rows, alarms))
    sys.exit(bool(wrong or alarms))


def page(rows, alarms):
    head = "| mistake | f64, 4-24-24-2 | f32, 4-24-24-2 | f32, 6-64-64-3 |\n| --- | --- | --- | --- |\n"
    table = lambda rows: head + "".join(f"| {' | '.join(row)} |\n" for row in rows)
    single, pairs = rows[: len(MISTAKES)], rows[len(MISTAKES) :]
    return f"""# `check` on planted mistakes

Written by `tests/check/torch_matrix.py` (PyTorch {torch.__version__.split("+")[0]}): a DQN update in PyTorch, its networks a few updates old,
batches of 32 with terminated and truncated transitions. "right": `check` names exactly the planted mistakes; ", or …":
it says that other mistakes give the same numbers, which they do. "not visible": the numbers of this
update are the same with and without the mistake, and `check` lists it among those that this update cannot show.

## Each mistake alone
{table(single)}
## Pairs
{table(pairs)}
## Right updates
{alarms} false alarms in 200 right updates: 0 to 3 hidden layers of 1 to 256 units (every tenth 4-256-256-2 with a batch of 256), batches
of 1 to 256, 1 to 6 actions, MSE and Huber, double and not, with and without target network and clipping, Adam 0 to 100
steps old, f32 and f64 in turn.
"""


if __name__ == "__main__":
    main()
