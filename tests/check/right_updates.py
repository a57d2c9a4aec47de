"""tests/check/right_updates.py --binary FILE [--count 200] [--numpy] [--table]: right DQN updates with every optimiser and setting that
`cartpole-dqn check` knows. Each must be equal. What `save_update` does not know of an optimiser it must say.

With PyTorch; with --numpy, as in CI, only with NumPy."""

import argparse
import collections
import pathlib
import sys
import tempfile
import time
import warnings

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "interop"))
from check_numpy import backward, forward  # noqa: E402
from planted import random_batch, save_update, verdict  # noqa: E402

# Class of PyTorch, its arguments, and what it is called in a file.
OPTIMIZERS = {
    "Adam": ("Adam", {}), "Adam, β and ε": ("Adam", {"betas": (0.8, 0.99), "eps": 1e-4}), "Adam, weight decay": ("Adam", {"weight_decay": 0.02}),
    "Adam, amsgrad": ("Adam", {"amsgrad": True}), "AdamW": ("AdamW", {}), "AdamW, weight decay": ("AdamW", {"weight_decay": 0.1}),
    "AdamW, amsgrad": ("AdamW", {"amsgrad": True}), "RMSprop": ("RMSprop", {}), "RMSprop, momentum": ("RMSprop", {"momentum": 0.9, "alpha": 0.95}),
    "RMSprop, weight decay": ("RMSprop", {"weight_decay": 0.02, "eps": 0.01}), "SGD": ("SGD", {}), "SGD, momentum": ("SGD", {"momentum": 0.9}),
    "SGD, momentum, weight decay": ("SGD", {"momentum": 0.8, "weight_decay": 0.02}),
}  # fmt: skip
# Other steps than `check` computes: only the rest of the update can be equal, and `save_update` says so.
UNKNOWN = {
    "RMSprop, centered": ("RMSprop", {"centered": True}), "SGD, Nesterov": ("SGD", {"momentum": 0.9, "nesterov": True}),
    "SGD, dampening": ("SGD", {"momentum": 0.9, "dampening": 0.5}), "Adam, maximize": ("Adam", {"maximize": True}),
    "NAdam": ("NAdam", {}), "Adagrad": ("Adagrad", {}),
}  # fmt: skip
NAMES = {"betas": None, "eps": "epsilon", "amsgrad": None}  # As settings; None where they have another form.


def option(seed):
    """The settings of an update, all of them in turn."""
    rng = np.random.default_rng(seed)
    hidden = [int(rng.choice([8, 24, 64])) for _ in range(rng.integers(1, 3))]
    return {
        "sizes": (int(rng.integers(2, 7)), *hidden, int(rng.integers(2, 5))), "size": int(rng.choice([1, 7, 32, 64])),
        "clipping": ("none", "norm, PyTorch", "norm, TensorFlow", "by value")[seed % 4], "loss": ("mse", "huber", "smooth_l1")[seed % 3],
        "delta": float(rng.choice([1.0, 0.3])), "double": bool(seed // 2 % 2), "weights": bool(seed // 3 % 2), "n": (1, 3)[seed // 4 % 2],
        "target": seed % 7 > 0, "steps": int(rng.choice([0, 1, 5, 30])), "gamma": float(rng.choice([0.9, 0.99])),
    }  # fmt: skip


def settings_of(option):
    given = {"gamma": option["gamma"], "double": option["double"], "loss": "mse" if option["loss"] == "mse" else "huber"}
    if option["loss"] != "mse":
        given["huber_delta"] = option["delta"]
    if option["clipping"] != "none":
        given["clip_value" if option["clipping"] == "by value" else "max_gradient_norm"] = 0.05
    return given


def batch_of(rng, option, dtype):
    batch = random_batch(rng, option["size"], option["sizes"][0], option["sizes"][-1], dtype)
    if option["n"] > 1:
        batch["discounts"] = option["gamma"] ** rng.integers(1, option["n"] + 1, size=option["size"]).astype(dtype)
    if option["weights"]:
        batch["weights"] = rng.uniform(0.1, 1, option["size"]).astype(dtype)
    return batch


class Torch:
    """Networks and an optimiser of PyTorch."""

    def __init__(self, seed, option, dtype, kind, arguments):
        import torch

        self.torch, self.option = torch, option
        torch.manual_seed(seed)
        torch.set_num_threads(1)
        self.online, self.target = self.network(dtype), self.network(dtype) if option["target"] else None
        self.optimizer = getattr(torch.optim, kind)(self.online.parameters(), lr=3e-3, **arguments)
        self.settings = {}

    def network(self, dtype):
        layers, nn = [], self.torch.nn
        for inputs, outputs in zip(self.option["sizes"], self.option["sizes"][1:]):
            layers += [nn.Linear(inputs, outputs, dtype=getattr(self.torch, dtype.__name__)), nn.ReLU()]
        return nn.Sequential(*layers[:-1])

    def update(self, batch):
        torch, functional, option = self.torch, self.torch.nn.functional, self.option
        batch = {name: torch.as_tensor(array) for name, array in batch.items()}
        with torch.no_grad():
            q = (self.online if self.target is None else self.target)(batch["next_observations"])
            best = (self.online(batch["next_observations"]) if option["double"] else q).argmax(1, keepdim=True)
            discounts = batch.get("discounts", option["gamma"])
            # A number times a tensor of bools would be rounded to f32.
            y = batch["rewards"] + discounts * (q.gather(1, best)[:, 0] * ~batch["terminated"])
        q = self.online(batch["observations"]).gather(1, batch["actions"][:, None])[:, 0]
        losses = {
            "mse": lambda: functional.mse_loss(q, y, reduction="none"),
            "huber": lambda: functional.huber_loss(q, y, reduction="none", delta=option["delta"]),
            "smooth_l1": lambda: functional.smooth_l1_loss(q, y, reduction="none", beta=option["delta"]),
        }[option["loss"]]()
        loss = (losses * batch["weights"] if option["weights"] else losses).mean()
        self.optimizer.zero_grad()
        loss.backward()
        parameters = list(self.online.parameters())
        if option["clipping"] == "norm, PyTorch":
            torch.nn.utils.clip_grad_norm_(parameters, 0.05)
        elif option["clipping"] == "norm, TensorFlow":
            norm = torch.sqrt(sum((p.grad**2).sum() for p in parameters))
            for p in parameters:
                p.grad *= 0.05 / torch.clamp(norm, min=0.05)
        elif option["clipping"] == "by value":
            torch.nn.utils.clip_grad_value_(parameters, 0.05)
        self.optimizer.step()
        return y, loss.detach()

    def before(self):
        return self.online, self.target, self.optimizer


class NumPy:
    """The same by hand."""

    def __init__(self, seed, option, dtype, kind, arguments):
        rng = np.random.default_rng(seed)
        make = lambda: [
            rng.uniform(-1, 1, shape).astype(dtype) / dtype(i**0.5)
            for i, o in zip(option["sizes"], option["sizes"][1:])
            for shape in ((i, o), (o,))
        ]
        self.online, self.target, self.option, self.dtype = make(), make() if option["target"] else None, option, dtype
        self.kind, self.arguments, self.steps = kind, arguments, 0
        self.first, self.second = ([np.zeros_like(w) for w in self.online] for _ in range(2))
        beta1, beta2 = arguments.get("betas", (0.9, 0.999))
        decay = {"weight_decay": 0.01} if kind == "AdamW" else {}
        given = {NAMES.get(name, name): value for name, value in arguments.items() if NAMES.get(name, name)}
        self.settings = {"optimizer_name": kind.lower(), "learning_rate": 3e-3, "beta1": beta1, "beta2": beta2, **decay, **given}

    def update(self, batch):
        option, rows = self.option, np.arange(self.option["size"])
        value = lambda network: forward(network, batch["next_observations"])[1]
        q = value(self.target or self.online)
        best = (value(self.online) if option["double"] else q).argmax(1)
        y = batch["rewards"] + batch.get("discounts", self.dtype(option["gamma"])) * ~batch["terminated"] * q[rows, best]
        inputs, q = forward(self.online, batch["observations"])
        error, delta = q[rows, batch["actions"]] - y, self.dtype(option["delta"])
        clipped = np.clip(error, -delta, delta)
        loss = {"mse": error**2, "huber": clipped * (error - clipped / 2), "smooth_l1": clipped * (error - clipped / 2) / delta}
        slope = {"mse": 2 * error, "huber": clipped, "smooth_l1": clipped / delta}[option["loss"]]
        weights = batch.get("weights", np.ones_like(y))
        dq = np.zeros_like(q)
        dq[rows, batch["actions"]] = slope * weights / self.dtype(len(y))
        gradients = backward(self.online, inputs, dq)
        norm = np.sqrt(sum((g**2).sum() for g in gradients))
        if option["clipping"].startswith("norm"):
            small = 1e-6 if option["clipping"] == "norm, PyTorch" else 0
            gradients = [g * self.dtype(min(1, 0.05 / (norm + small))) for g in gradients]
        elif option["clipping"] == "by value":
            gradients = [np.clip(g, self.dtype(-0.05), self.dtype(0.05)) for g in gradients]
        self.steps += 1
        moved = [self.step(*tensors) for tensors in zip(self.online, gradients, self.first, self.second)]
        self.online, self.first, self.second = ([np.asarray(w, self.dtype) for w in part] for part in zip(*moved))
        return {"targets": y, "loss": (loss[option["loss"]] * weights).mean(), "gradients": gradients, "online": self.online}

    def step(self, w, g, m, v):
        """A weight, m and v after a step."""
        given, kind = self.arguments, self.kind
        decay, epsilon = given.get("weight_decay", 0.01 if kind == "AdamW" else 0.0), given.get("eps", 1e-8)
        g = g if kind == "AdamW" else g + decay * w
        if kind.startswith("Adam"):
            beta1, beta2 = given.get("betas", (0.9, 0.999))
            m, v = beta1 * m + (1 - beta1) * g, beta2 * v + (1 - beta2) * g * g
            step = m / (1 - beta1**self.steps) / (np.sqrt(v / (1 - beta2**self.steps)) + epsilon)
            return w * (1 - 3e-3 * decay * (kind == "AdamW")) - 3e-3 * step, m, v
        if kind == "RMSprop":
            alpha = given.get("alpha", 0.99)
            v = alpha * v + (1 - alpha) * g * g
            g = g / (np.sqrt(v) + epsilon)
        m = given.get("momentum", 0.0) * m + g
        return w - 3e-3 * m, m, v

    def before(self):
        return self.online, self.target, (self.steps, self.first, self.second) if self.steps else None


def judged(binary, path, backend, seed, dtype, kind, arguments):
    """Writes one update; the exit code, the verdict, and what `save_update` said."""
    one = option(seed)
    learner, rng = backend(seed, one, dtype, kind, arguments), np.random.default_rng(seed)
    for _ in range(one["steps"]):
        learner.update(batch_of(rng, one, dtype))
    batch = batch_of(rng, one, dtype)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        save_update(path, *learner.before(), batch, lambda: learner.update(batch), **settings_of(one), **learner.settings)
    return *verdict(binary, path), [str(warning.message) for warning in said]


def asking_changes_nothing(directory):
    """A network with layers that draw numbers, count and learn in other ways is asked for its Q-values, and left as it was."""
    import torch

    class Own(torch.nn.Module):
        def __init__(self, result):
            super().__init__()
            self.layer, self.result = torch.nn.Linear(4, 2), result

        def forward(self, x):
            return self.result(self.layer(x + torch.rand(1)))

    def raises(_):
        raise RuntimeError("other observations")

    linear, nn, batch = torch.nn.Linear, torch.nn, random_batch(np.random.default_rng(1), 8, 4, 2)
    many = nn.Sequential(nn.BatchNorm1d(4, affine=False), nn.ReLU(inplace=True), linear(4, 8), nn.Dropout(0.5), nn.RReLU(), linear(8, 2))
    many[4].eval()
    networks = {True: [many, Own(lambda q: q), many.double()], False: [Own(raises), Own(lambda q: (q, q)), Own(lambda q: q.half()), Own(lambda q: q[0])]}
    for has_q, network in ((has_q, network) for has_q, those in networks.items() for network in those):
        torch.manual_seed(3)
        state = lambda: [torch.get_rng_state(), *(v.clone() for v in network.state_dict().values())]
        modes, before, seen = [m.training for m in network.modules()], state(), []

        def update():
            seen.extend([modes == [m.training for m in network.modules()], all(map(torch.equal, before, state()))])
            seen.append(torch.is_grad_enabled() and all(p.grad is None for p in network.parameters()))
            return None, 1.0

        save_update(f"{directory}/asked.safetensors", network, network, None, batch, update)
        if seen != [True, True, True] or (b"result.q" in pathlib.Path(f"{directory}/asked.safetensors").read_bytes()) != has_q:
            sys.exit(f"FAILED: asked wrongly: {network} {seen}")
    print("asking a network changes nothing")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", required=True)
    parser.add_argument("--count", type=int, default=200, help="updates of each optimiser, half of them in f64")
    parser.add_argument("--numpy", action="store_true")
    parser.add_argument("--table", action="store_true", help="print the tables of docs/results/check.md")
    parser.add_argument("--keep", help="a directory for the files of false alarms")
    arguments = parser.parse_args()
    # Without its largest v an amsgrad is Adam: NumPy's form has no place for it.
    optimizers = {name: one for name, one in OPTIMIZERS.items() if not (arguments.numpy and "amsgrad" in name)}
    alarms, silent, begin = collections.Counter(), [], time.monotonic()
    counts = collections.Counter()
    with tempfile.TemporaryDirectory() as directory:
        if not arguments.numpy:
            asking_changes_nothing(directory)
        for name, (kind, given) in optimizers.items():
            for dtype in (np.float32, np.float64):
                for seed in range(arguments.count // 2):
                    path = f"{arguments.keep or directory}/{name.replace(' ', '_')}.{dtype.__name__}.{seed}.safetensors"
                    code, found, said = judged(arguments.binary, path, NumPy if arguments.numpy else Torch, seed, dtype, kind, given)
                    one = option(seed)
                    keys = [f"{name}, {dtype.__name__}", *(f"{key} {one[key]}" for key in ("clipping", "loss", "double", "weights", "n", "target"))]
                    counts.update(keys)
                    if code or said:
                        alarms.update(keys)
                        states = [(q["name"], q["state"]) for q in found["quantities"]]
                        print(f"FALSE ALARM {path}: {one} {states} {found['explanations'][:1]} {said}", flush=True)
                    else:
                        pathlib.Path(path).unlink()
        for name, (kind, given) in UNKNOWN.items():
            for seed in range(0 if arguments.numpy else min(arguments.count, 20)):
                code, found, said = judged(arguments.binary, f"{directory}/unknown.safetensors", Torch, seed, np.float32, kind, given)
                states = {q["name"]: q["state"] for q in found["quantities"]}
                if code or states["weights"] != "absent" or len(said) != 1:
                    silent.append(name)
                    print(f"NOT SAID: {name} {states} {said}")
    if arguments.table:
        print("| | updates | false alarms |\n| --- | --- | --- |")
        print("\n".join(f"| {key} | {count} | {alarms[key]} |" for key, count in counts.items()))
    wrong = sum(alarms[key] for key in counts if key.endswith(("float32", "float64")))
    total = sum(count for key, count in counts.items() if key.endswith(("float32", "float64")))
    print(f"{wrong} false alarms in {total} right updates, {time.monotonic() - begin:.0f} s")
    sys.exit(bool(wrong or silent))


if __name__ == "__main__":
    main()
