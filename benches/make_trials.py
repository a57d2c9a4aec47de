"""Makes a study of the default config with N finished trials that nobody has trained, to measure `report` and `--status`.

    python3 benches/make_trials.py DIR N [--binary target/release/cartpole-dqn] [--files 64]

The trials look as real ones do, in size and in numbers: learning curves that rise to 500 and sometimes collapse.
"""

import argparse
import json
import pathlib
import random
import subprocess

ROOT = pathlib.Path(__file__).resolve().parents[1]
BATCH = 1000  # trials that are made at once

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("directory", type=pathlib.Path)
parser.add_argument("trials", type=int)
parser.add_argument("--binary", type=pathlib.Path, default=ROOT / "target/release/cartpole-dqn")
parser.add_argument("--files", type=int, default=64)
arguments = parser.parse_args()

subprocess.run([arguments.binary.resolve(), "study", "--plan", "--quiet", "--seeds", f"0..{arguments.trials}",
                "--out", arguments.directory], check=True)
named = json.loads((arguments.directory / "study.json").read_text())["configs"][0]
config, budget = named["config"], named["config"]["budget"]["steps"]
steps = range(config["evaluation"]["every_steps"], budget + 1, config["evaluation"]["every_steps"])
randomness = random.Random(0)


def mean(step):
    """Of 50 episodes."""
    learned = min(1, step / budget * randomness.uniform(2, 40))
    collapsed = randomness.random() < 0.02
    return min(500, round(50 * max(9, 520 * learned * (randomness.uniform(0.2, 0.9) if collapsed else 1))) / 50)


evaluations = {step: [json.dumps({"env_steps": step, "mean": mean(step)}, separators=(",", ":")) for _ in range(20_000)]
               for step in steps}
scores = [500.0] * 9_000 + [round(randomness.uniform(480, 500), 2) for _ in range(900)] + [
    round(randomness.uniform(9, 475), 2) for _ in range(100)]
summary = {"seed": 0, "env_steps": budget, "episodes": 223, "updates": 49_000, "end_reason": "budget",
           "best_evaluation": {"env_steps": budget, "mean": 500.0}, "final_evaluation": {"env_steps": budget, "mean": 500.0},
           "solved_at_step": 2000, "weights_sha256": "0" * 64}


def score(mean):
    return {"env_steps": budget, "mean": mean, "std": 0.0, "min": mean, "median": mean, "max": mean}


def text(value):
    return json.dumps(value, separators=(",", ":"))


trials = arguments.directory / "trials"
trials.mkdir()
bests = [text(score(value)) for value in scores]
files = [open(trials / f"made-{i}.jsonl", "w") for i in range(min(arguments.files, arguments.trials))]
name = text(named["name"])
for start in range(0, arguments.trials, BATCH):
    seeds = range(start, min(start + BATCH, arguments.trials))
    curves = zip(*(randomness.choices(evaluations[step], k=len(seeds)) for step in steps))
    pairs = zip(randomness.choices(bests, k=len(seeds)), randomness.choices(bests, k=len(seeds)))
    for seed, curve, (best, final) in zip(seeds, curves, pairs):
        files[seed % len(files)].write(
            f'{{"config":{name},"seed":{seed},"error":null,"summary":{text(summary | {"seed": seed})},"best":{best},'
            f'"final":{final},"evaluations":[{",".join(curve)}]}}\n'
        )
