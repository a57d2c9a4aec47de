#!/usr/bin/env python3
"""Runs the Python snippets of docs/interop.md and docs/python.md, and the programs with Optuna to which they link, as they
stand, and checks what they bring.

    python snippets.py --binary target/release/cartpole-dqn          # those that need NumPy and Gymnasium alone
    python snippets.py --binary target/release/cartpole-dqn --all    # PyTorch and Stable-Baselines3 too
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = [ROOT / "docs" / "interop.md", ROOT / "docs" / "python.md"]
OBSERVATION = np.array([0.0, 0.0, 0.01, 0.0], dtype=np.float32)


def require(condition, message):
    if not condition:
        sys.exit(f"FAILED: {message}")


def snippets():
    """Name -> code, in the order of the documents."""
    text = "".join(document.read_text() for document in DOCUMENTS)
    found = dict(re.findall(r"<!-- snippet: (\w+) -->\n```python\n(.*?)```\n", text, re.DOTALL))
    require(len(found) == text.count("```python"), "a snippet has no name")
    found |= {path.stem: path.read_text() for path in sorted((ROOT / "examples").glob("*.py"))}
    require(found.keys() == CHECKS.keys(), "a snippet has no check")
    return found


class RunDirectory:
    """A directory with a default run in runs/mine, and a run of a table in runs/table."""

    def __init__(self, binary, path):
        self.binary, self.path = Path(binary).resolve(), Path(path)
        self.program("train", "--quiet", "--out", "runs/mine")
        self.program("train", "--quiet", "--config", ROOT / "configs/q_table.json", "--out", "runs/table")

    def program(self, *arguments):
        return subprocess.run([self.binary, *arguments], cwd=self.path, check=True, capture_output=True, text=True).stdout

    def mean(self, checkpoint, episodes):
        return json.loads(self.program("eval", "--json", "--checkpoint", checkpoint, "--episodes", episodes))["mean"]

    def q_values(self):
        """Of OBSERVATION, by NumPy."""
        from safetensors.numpy import load_file

        tensors, x = load_file(self.path / "runs/mine/checkpoints/best.safetensors"), OBSERVATION
        for i in (0, 2, 4):
            x = tensors[f"{i}.weight"] @ x + tensors[f"{i}.bias"]
            x = np.maximum(x, 0) if i < 4 else x
        return x


def prints_the_mean(episodes, run="runs/mine"):
    def check(directory, printed):
        mean = directory.mean(run, episodes)
        require(abs(float(printed) - mean) < 5, f"mean return {printed}, eval's is {mean}")
        return f"mean return {float(printed)}, eval's is {mean}"

    return check


def prints_the_q_values(directory, printed):
    values = np.array([float(number) for number in re.findall(r"-?\d+\.\d+(?:e-?\d+)?", printed)])
    ours = directory.q_values()
    require(np.allclose(values, ours, rtol=1e-3, atol=1e-3), f"Q-values {values}, not {ours}")
    return f"Q-values {values}"


def prints_the_evaluations(directory, printed):
    lines = [json.loads(line) for line in (directory.path / "runs/mine/metrics.jsonl").read_text().splitlines()]
    expected = [[str(line["env_steps"]), str(line["mean"])] for line in lines if line["event"] == "evaluation"]
    require([line.split() for line in printed.splitlines()] == expected, f"{printed}, not {expected}")
    return f"{len(expected)} evaluations"


def prints_the_updates(directory, printed):
    updates = json.loads((directory.path / "runs/mine/summary.json").read_text())["updates"]
    require(re.fullmatch(rf"\(\d+,\) {updates}\n", printed), f"{printed}, not {updates} updates")
    return printed.strip()


def leaves_a_policy(least_mean):
    def check(directory, _):
        mean = directory.mean("policy.safetensors", "100")
        require(mean >= least_mean, f"eval's mean return of the policy is {mean}, expected at least {least_mean}")
        return f"eval's mean return {mean}"

    return check


def finds_settings(trials, least_mean):
    def check(_, printed):
        count, pruned, best, settings = printed.strip().split(" ", 3)
        require(int(count) == trials and float(best) >= least_mean, f"{count} trials, the best {best}")
        return f"{count} trials, {pruned} pruned, best {float(best):.1f} with {settings}"

    return check


# Name -> whether it needs PyTorch, and what must have come of it.
CHECKS = {
    "numpy": (False, prints_the_mean("10")),
    "table": (False, prints_the_mean("10", "runs/table")),
    "torch": (True, prints_the_q_values),
    "sb3": (True, prints_the_mean("100")),
    "cleanrl": (True, prints_the_q_values),
    # Enough to tell a policy that has learned from one of swapped or shuffled weights, which falls before step 30.
    "from_sb3": (True, leaves_a_policy(100)),
    "from_numpy": (False, leaves_a_policy(100)),
    "policy": (False, prints_the_mean("10")),
    "metrics": (False, prints_the_evaluations),
    "tensors": (False, prints_the_updates),
    "program": (False, prints_the_mean("100")),
    "optuna_search": (False, finds_settings(20, 475)),
    "optuna_seeds": (False, finds_settings(6, 100)),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", required=True, help="the cartpole-dqn to run")
    parser.add_argument("--all", action="store_true", help="also what needs PyTorch")
    arguments = parser.parse_args()
    codes = snippets()
    with tempfile.TemporaryDirectory() as path:
        directory = RunDirectory(arguments.binary, path)
        for name, code in codes.items():
            needs_torch, check = CHECKS[name]
            if needs_torch and not arguments.all:
                print(f"{name}: NOT RUN, it needs PyTorch; --all runs it")
                continue
            begin = time.monotonic()
            path_with_program = f"{directory.binary.parent}{os.pathsep}{os.environ['PATH']}"
            result = subprocess.run([sys.executable, "-c", code], cwd=path, capture_output=True, text=True,
                                    env=os.environ | {"PATH": path_with_program, "PYTHONPATH": str(ROOT / "python")})
            require(result.returncode == 0, f"{name}: {result.stderr}")
            print(f"{name}: {check(directory, result.stdout)} ({time.monotonic() - begin:.1f} s)")


if __name__ == "__main__":
    main()
