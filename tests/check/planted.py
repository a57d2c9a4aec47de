"""What the scripts that check `cartpole-dqn check` have in common: snippets of docs/check.md, batches, verdicts."""

import json
import pathlib
import re
import subprocess

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]


def snippet(framework):
    """`save_update` of docs/check.md, as it is pasted from there."""
    text = (ROOT / "docs/check.md").read_text()
    code = re.search(rf"<!-- snippet: {framework} -->\n```python\n(.*?)```", text, re.DOTALL)[1]
    namespace = {}
    exec(code, namespace)
    return namespace["save_update"]


def random_batch(rng, size, inputs, actions, dtype=np.float32):
    """Transitions with both ends, and rewards beyond 1."""
    ends = rng.permutation(size)
    terminated, truncated = np.zeros(size, bool), np.zeros(size, bool)
    terminated[ends[: max(1, size // 5)]] = True
    truncated[ends[max(1, size // 5) : max(2, size // 3)]] = True
    return {
        "observations": rng.normal(size=(size, inputs)).astype(dtype),
        "actions": rng.integers(actions, size=size),
        "rewards": rng.normal(0.5, 1.0, size=size).astype(dtype),
        "next_observations": rng.normal(size=(size, inputs)).astype(dtype),
        "terminated": terminated,
        "truncated": truncated,
    }


def verdict(binary, path):
    """The exit code and what --json prints."""
    done = subprocess.run([binary, "check", "--json", path], capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stderr
    return done.returncode, json.loads(done.stdout)


def explained(found):
    """Every set of mistakes that explains the numbers, as sets of names."""
    return [frozenset(mistake["id"] for mistake in explanation) for explanation in found["explanations"]]
