"""tests/check/loop_mistakes.py --binary FILE --results FILE [--steps N] [--seeds N] [--framework numpy|torch|jax|keras]: plants the 40 mistakes
of tests/interop/recorder.py in loops, and counts how many `cartpole-dqn check` names. A run that was stopped goes on where it was;
--table prints what the results have.

With another framework than NumPy the recorder gets that one's networks, batches and numbers. Keras' are stand-ins with its interface."""

import argparse
import collections
import json
import pathlib
import sys
import tempfile
import warnings

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "interop"))
import recorder  # noqa: E402

NumPyRecorder = recorder.Recorder


def torch_forms():
    import torch

    torch.set_num_threads(1)

    def network(weights, known):
        if known is None:
            layers = []
            for weight in weights[::2]:
                layers += [torch.nn.Linear(*weight.shape), torch.nn.ReLU()]
            known = torch.nn.Sequential(*layers[:-1])
        with torch.no_grad():
            for parameter, weight in zip(known.parameters(), weights):
                parameter.copy_(torch.from_numpy(weight.T))
        return known

    return network, torch.as_tensor


def jax_forms():
    import jax.numpy as jnp

    tree = lambda weights, _: {f"Dense_{i}": {"kernel": jnp.array(weights[2 * i]), "bias": jnp.array(weights[2 * i + 1])} for i in range(len(weights) // 2)}
    return tree, jnp.asarray


def keras_forms():
    class Variable:
        name = "kernel"

        def numpy(self):
            return self.value.copy()

    class Model:
        def __init__(self, count):
            self.weights = self.trainable_variables = [Variable() for _ in range(count)]

    def network(weights, known):
        known = known or Model(len(weights))
        for variable, weight in zip(known.weights, weights):
            variable.value = weight
        return known

    return network, np.asarray


def recorder_of(framework):
    """A recorder that gives on what NumPy's loop tells in the form of a framework."""
    if framework == "numpy":
        return NumPyRecorder
    network, array = {"torch": torch_forms, "jax": jax_forms, "keras": keras_forms}[framework]()

    class Other(NumPyRecorder):
        networks = None, None

        def acting(self, q_values=None, epsilon=None):
            super().acting(None if q_values is None else array(q_values), epsilon)

        def learned(self, online, target, batch, targets, loss, optimizer):
            own = network(online, self.networks[0])
            self.networks = own, own if target is online else network(target, self.networks[1])
            batch = {name: array(column) for name, column in batch.items()}
            super().learned(*self.networks, batch, array(targets), array(np.float32(loss)), optimizer)

    return Other


def table(results):
    counts = collections.defaultdict(lambda: [0, 0, 0])
    columns = sorted({(one["framework"], one["steps"]) for one in results}, key=lambda column: (column[0] != "numpy", column))
    for one in results:
        for row in (one["mistake"], "all"):
            cell = counts[row, one["framework"], one["steps"]]
            cell[0] += 1
            cell[1] += one["mistake"] in one["named"]
            cell[2] += any(name != one["mistake"] for name in one["named"])
    head = "".join(f" {framework}, {steps:,} |" for framework, steps in columns)
    print(f"| mistake |{head}\n| --- |{' --- |' * len(columns)}")
    for mistake in [*recorder.MISTAKES, "all"]:
        cells = [counts.get((mistake, *column)) for column in columns]
        print(f"| {mistake} |" + "".join(f" {cell[1]} of {cell[0]}{f', beside others {cell[2]}' if cell[2] else ''} |" if cell else " |" for cell in cells))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary")
    parser.add_argument("--results", required=True, type=pathlib.Path)
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--framework", default="numpy")
    parser.add_argument("--only", nargs="+", default=list(recorder.MISTAKES))
    parser.add_argument("--table", action="store_true")
    arguments = parser.parse_args()
    np.seterr(all="ignore")
    warnings.simplefilter("ignore")
    results = [json.loads(line) for line in arguments.results.read_text().splitlines()] if arguments.results.exists() else []
    if arguments.table:
        return table(results)
    known = {(one["framework"], one["steps"], one["mistake"], one["seed"]) for one in results}
    recorder.Recorder = recorder_of(arguments.framework)
    with tempfile.TemporaryDirectory() as directory:
        for seed in range(arguments.seeds):
            for mistake in arguments.only:
                key = (arguments.framework, arguments.steps, mistake, seed)
                if key in known:
                    continue
                path = f"{directory}/one.trace"
                recorder.record(path, mistake, recorder.MISTAKES[mistake], seed, arguments.steps)
                named, _ = recorder.judged(arguments.binary, path)
                one = dict(zip(("framework", "steps", "mistake", "seed"), key), named=named)
                with arguments.results.open("a") as file:
                    file.write(json.dumps(one) + "\n")
                if named != [mistake]:
                    print(f"{key}: {named}", flush=True)


if __name__ == "__main__":
    main()
