"""Records rliable's numbers on small matrices of scores: tests/data/rliable.json.

    pip install rliable==1.2.0
    python tests/data/record_rliable.py

Scores are mean returns of CartPole-v1, one row per training seed and one column, the task. Two statistics are not in
rliable and are computed as it would: the median over seeds (its own is over tasks) with `numpy.median` in its bootstrap,
and the interval of a difference of IQMs with its bootstrap of two independent groups.
"""

import importlib.metadata
import json
import pathlib

import numpy as np
from rliable import library, metrics

REPS = 50_000


def matrices():
    rng = np.random.default_rng(0)
    half = np.where(rng.random(100) < 0.5, 500.0, rng.uniform(9.0, 475.0, 100))
    most = np.where(rng.random(80) < 0.9, 500.0, rng.uniform(100.0, 499.0, 80))
    return {
        "uniform": rng.uniform(9.0, 500.0, 30),
        "ties": np.array([9.5, 500.0, 500.0, 475.0, 120.25, 500.0, 500.0, 9.5, 300.0, 475.0, 500.0]),
        "half": np.round(half, 2),
        "most": np.round(most, 2),
        "constant": np.full(12, 500.0),
    }


def interval(scores, function):
    name = "x"
    _, bounds = library.get_interval_estimates(
        {name: scores}, lambda *s: np.array([function(*s)]), reps=REPS, random_state=np.random.RandomState(1)
    )
    return [float(bound) for bound in bounds[name][:, 0]]


def single(scores):
    column = scores[:, None]
    functions = {"iqm": metrics.aggregate_iqm, "mean": metrics.aggregate_mean, "median": np.median}
    recorded = {"scores": scores.tolist()}
    for name, function in functions.items():
        recorded[name] = {"value": float(function(column)), "interval": interval(column, function)}
    taus = [50.0, 300.0, 474.5, 499.0]
    profile, _ = library.create_performance_profile({"x": column}, np.array(taus), reps=10)
    recorded["profile"] = {"tau": taus, "share": profile["x"].tolist()}
    return recorded


def pair(x, y):
    x, y = x[:, None], y[:, None]
    functions = {
        "probability_of_improvement": metrics.probability_of_improvement,
        "iqm_difference": lambda a, b: metrics.aggregate_iqm(a) - metrics.aggregate_iqm(b),
    }
    return {
        name: {"value": float(function(x, y)), "interval": interval((x, y), function)}
        for name, function in functions.items()
    }


def main():
    data = matrices()
    pairs = [("uniform", "half"), ("most", "half"), ("ties", "uniform"), ("constant", "most"), ("half", "half")]
    recorded = {
        "versions": {name: importlib.metadata.version(name) for name in ["rliable", "arch", "scipy", "numpy"]},
        "reps": REPS,
        "single": {name: single(scores) for name, scores in data.items()},
        "pairs": [{"x": x, "y": y, **pair(data[x], data[y])} for x, y in pairs],
    }
    path = pathlib.Path(__file__).with_name("rliable.json")
    path.write_text(json.dumps(recorded, indent=1) + "\n")


main()
