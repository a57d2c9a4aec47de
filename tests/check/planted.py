"""What the scripts that check `cartpole-dqn check` have in common: `save_update` of the Python module, batches, verdicts."""

import json
import pathlib
import subprocess
import sys

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "python"))
from cartpole_dqn import save_update  # noqa: E402, F401


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
