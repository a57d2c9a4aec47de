"""Trains configs/cartpole.json over many seeds and writes what came of it into default.md and default/.

    cargo build --release && python3 docs/results/default.py [--study DIR] [--seeds A..B]
"""

import argparse
import csv
import json
import os
import pathlib
import re
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PROGRAM = os.environ.get("CARTPOLE_DQN", ROOT / "target/release/cartpole-dqn")
CONFIG = ROOT / "configs/cartpole.json"

arguments = argparse.ArgumentParser()
arguments.add_argument("--study", type=pathlib.Path, default=ROOT / "studies/default")
arguments.add_argument("--seeds", default="700000..701000")
arguments = arguments.parse_args()
study = arguments.study


def run(*words):
    return subprocess.run([PROGRAM, *map(str, words)], check=True, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE).stdout


def lasting(seed):
    """The seconds of CPU of a run, and of how many of eval's 100 starts its final policy falls within 20,000 steps."""
    out = study / f"run-{seed}"
    run("train", "--config", CONFIG, "--seed", seed, "--out", out, "--quiet")
    seconds = json.loads((out / "summary.json").read_text())["cpu_seconds"]
    returns = json.loads(run("eval", out / "checkpoints/last.safetensors", "--max-steps", 20000, "--json"))["returns"]
    shutil.rmtree(out)
    return seconds, sum(steps < 20000 for steps in returns)


run("study", "--config", CONFIG, "--seeds", arguments.seeds, "--out", study, "--quiet")
run("report", study)
lines = {line for path in (study / "trials").glob("*.jsonl") for line in path.read_text().splitlines()}
trials = [json.loads(line) for line in lines]
trials.sort(key=lambda trial: trial["seed"])
with ThreadPoolExecutor(os.cpu_count()) as threads:
    played = dict(zip([trial["seed"] for trial in trials], threads.map(lasting, [trial["seed"] for trial in trials])))
with open(HERE / "default/seeds.csv", "w", newline="") as file:
    rows = csv.writer(file, lineterminator="\n")
    rows.writerow(["seed", "best_mean", "final_mean", "final_falls", "solved_at_step", "env_steps", "evaluation_steps",
                   "lasting_test_steps", "end_reason", "weights_sha256"])
    for trial in trials:
        summary = trial["summary"]
        rows.writerow([trial["seed"], trial["best"]["mean"], trial["final"]["mean"], played[trial["seed"]][1],
                       *(summary[key] for key in ["solved_at_step", "env_steps", "evaluation_steps", "lasting_test_steps",
                                                  "end_reason", "weights_sha256"])])
for name in ["report.json", "study.json", "learning_curves.svg", "performance_profile.svg", "steps_to_solve.svg"]:
    shutil.copy(study / name, HERE / "default" / name)

config = json.loads((study / "report.json").read_text())["configs"][0]
solve, price, count = config["steps_to_solve"], config["steps_played"], config["seeds"]
share = lambda estimate: "{:.1f} % [{:.1f}, {:.1f}]".format(*(100 * estimate[k] for k in ["value", "low", "high"]))
number = lambda estimate: "{value:.1f} [{low:.1f}, {high:.1f}]".format(**estimate)
ends = sorted(trial["summary"]["env_steps"] for trial in trials)
quantile = lambda share: f"{ends[int(share * (count - 1))]:,}"
passed = sum(trial["summary"]["end_reason"] == "lasting" for trial in trials)
lowest = min(trial["best"]["mean"] for trial in trials)
falling = [f"{seed} (from {falls})" for seed, (_, falls) in played.items() if falls]
seconds = sorted(seconds for seconds, _ in played.values())
failing = [
    f"seed {trial['seed']} (best {trial['best']['mean']:.1f}, final {trial['final']['mean']:.1f})"
    for trial in trials
    if min(trial["best"]["mean"], trial["final"]["mean"]) < 475
]
table = f"""| | measured |
| --- | --- |
| best checkpoint ≥ 475 | {config['best_solved']:,} of {count:,} ({share(config['best_solved_share'])}); the lowest {lowest:.1f} |
| final policy ≥ 475 | {config['final_solved']:,} of {count:,} ({share(config['final_solved_share'])}) |
| final IQM | {number(config['final_iqm'])} |
| final mean | {number(config['final_mean'])} |
| steps to the first solving evaluation: 10 %, 50 %, 90 % of seeds | {solve['q10']:,}, {solve['q50']:,}, {solve['q90']:,}; never on {solve['never']} |
| runs that ended with a policy that passed their own test | {passed:,} of {count:,} |
| steps at the end of the run: 10 %, 50 %, 90 %, all of the seeds | {quantile(0.1)}, {quantile(0.5)}, {quantile(0.9)}, {quantile(1)} |
| final policy lasts | {count - len(falling):,} of {count:,} |

Seeds whose final policy does not last, and from how many of 100 starts it falls: {", ".join(falling) or "none"}.

Seeds that do not solve the task: {"; ".join(failing) or "none"}.
"""
price = f"""| median over the seeds | |
| --- | --- |
| environment steps of training | {price['training']:,} |
| steps played in evaluations | {price['evaluations']:,} |
| steps played in tests whether a policy lasts | {price['lasting_tests']:,} |
| seconds of CPU | {seconds[(count - 1) // 2]:.3f} |
"""
page = HERE / "default.md"
for mark, text in [("measured", table), ("price", price)]:
    between = rf"(<!-- {mark} -->\n).*?(<!-- end -->)"
    page.write_text(re.sub(between, lambda match: match[1] + text + match[2], page.read_text(), flags=re.S))
