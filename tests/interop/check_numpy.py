"""tests/interop/check_numpy.py --binary FILE: a DQN update in NumPy, written with `save_update` of the Python module. Right, it
must be equal; with each of some planted mistakes, `cartpole-dqn check` must name that one.

Needs numpy."""

import argparse
import pathlib
import sys
import tempfile

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "check"))
from planted import explained, random_batch, save_update, verdict  # noqa: E402

GAMMA, ALPHA = 0.9, 3e-3


def forward(network, x):
    """The input of every layer, and the output."""
    inputs = []
    for layer in range(0, len(network), 2):
        inputs.append(x)
        x = x @ network[layer] + network[layer + 1]
        if layer + 2 < len(network):
            x = np.maximum(x, 0)
    return inputs, x


def backward(network, inputs, dy):
    gradients = []
    for layer in range(len(network) - 2, -1, -2):
        x = inputs[layer // 2]
        gradients = [x.T @ dy, dy.sum(0), *gradients]
        dy = (dy @ network[layer].T) * (x > 0)
    return gradients


def targets(batch, online, target, mistake):
    q = forward(online if mistake == "bootstrap_from_online" else target, batch["next_observations"])[1]
    mask = 1 - batch["terminated"]
    if mistake == "terminal_bootstrapped":
        mask = np.ones_like(mask)
    if mistake == "truncation_not_bootstrapped":
        mask = mask * (1 - batch["truncated"])
    if mistake == "mask_inverted":
        mask = 1 - mask
    return batch["rewards"] + GAMMA * mask * (q.argmax(1) if mistake == "index_in_place_of_value" else q.max(1))


def update(batch, online, target, adam, mistake):
    y = targets(batch, online, target, mistake)
    inputs, q = forward(online, batch["observations"])
    rows, actions = np.arange(len(y)), batch["actions"]
    error = q[rows, actions] - y
    count = 1 if mistake == "sum" else len(y)
    dq = np.zeros_like(q)
    if mistake == "gradient_of_all_actions":
        dq += (2 * error / count)[:, None]
    else:
        dq[rows, (actions + (mistake == "gradient_of_wrong_action")) % q.shape[1]] = 2 * error / count
    gradients = backward(online, inputs, dq)
    steps, first, second = adam
    t = steps + (0 if mistake == "step_count_behind" else 1)
    after = []
    for weight, g, m, v in zip(online, gradients, first, second):
        m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g * g
        if mistake == "adam_uncorrected":
            step = m / (np.sqrt(v) + 1e-8)
        else:
            step = m / (1 - 0.9**t) / (np.sqrt(v / (1 - 0.999**t)) + 1e-8)
        after.append(weight - ALPHA * (g if mistake == "sgd" else step))
    return {"targets": y, "loss": (error**2).sum() / count, "gradients": gradients, "online": after}


MISTAKES = [
    "terminal_bootstrapped", "truncation_not_bootstrapped", "mask_inverted", "bootstrap_from_online",
    "index_in_place_of_value", "sum", "gradient_of_all_actions", "gradient_of_wrong_action", "adam_uncorrected", "sgd",
    "step_count_behind",
]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--binary", required=True)
    binary = parser.parse_args().binary
    with tempfile.TemporaryDirectory() as directory:
        for dtype in (np.float32, np.float64):
            for mistake in [None, *MISTAKES]:
                rng = np.random.default_rng(len(mistake or ""))
                sizes = [(4, 24), (24,), (24, 24), (24,), (24, 2), (2,)]
                random = lambda scale: [rng.normal(scale=scale, size=size).astype(dtype) for size in sizes]
                online, target, first = random(0.3), random(0.3), random(0.01)
                adam = (20, first, [m * m + dtype(1e-6) for m in first])
                batch = random_batch(rng, 32, 4, 2, dtype)
                path = str(pathlib.Path(directory) / "update.safetensors")
                results = update(batch, online, target, adam, mistake)
                save_update(path, online, target, adam, batch, results, gamma=GAMMA, learning_rate=ALPHA)
                code, found = verdict(binary, path)
                expected = (1, frozenset([mistake])) if mistake else (0, None)
                if code != expected[0] or (mistake and expected[1] not in explained(found)):
                    sys.exit(f"{dtype.__name__} {mistake}: {found}")
                print(f"{dtype.__name__} {mistake or 'right'}: {'named' if mistake else 'equal'}")


if __name__ == "__main__":
    main()
