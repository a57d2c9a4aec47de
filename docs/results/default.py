"""Trains configs/cartpole.json over many seeds and writes what came of it into default.md and default/.

    cargo build --release && python3 docs/results/default.py [--study DIR] [--seeds N]
"""

import argparse
import csv
import json
import pathlib
import re
import shutil
import subprocess

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PROGRAM = ROOT / "target/release/cartpole-dqn"

arguments = argparse.ArgumentParser()
arguments.add_argument("--study", type=pathlib.Path, default=ROOT / "studies/default")
arguments.add_argument("--seeds", type=int, default=1000)
arguments = arguments.parse_args()
study = arguments.study

run = lambda *words: subprocess.run([PROGRAM, *map(str, words)], check=True)
run("study", "--config", ROOT / "configs/cartpole.json", "--seeds", f"0..{arguments.seeds}", "--lasting",
    "--out", study, "--quiet")
run("report", study)

lines = {line for path in (study / "trials").glob("*.jsonl") for line in path.read_text().splitlines()}
trials = [json.loads(line) for line in lines]
trials.sort(key=lambda trial: trial["seed"])
with open(HERE / "default/seeds.csv", "w", newline="") as file:
    rows = csv.writer(file, lineterminator="\n")
    rows.writerow(["seed", "best_mean", "best_env_steps", "final_mean", "best_lasts", "final_lasts",
                   "solved_at_step", "env_steps", "end_reason", "weights_sha256"])
    for trial in trials:
        best, final, summary = trial["best"], trial["final"], trial["summary"]
        rows.writerow([trial["seed"], best["mean"], best["env_steps"], final["mean"], best["lasts"],
                       final["lasts"], summary["solved_at_step"], summary["env_steps"], summary["end_reason"],
                       summary["weights_sha256"]])
for name in ["report.json", "study.json", "learning_curves.svg", "performance_profile.svg", "steps_to_solve.svg"]:
    shutil.copy(study / name, HERE / "default" / name)

config = json.loads((study / "report.json").read_text())["configs"][0]
solve, lasts, count = config["steps_to_solve"], config["lasting"], config["seeds"]
share = lambda estimate: "{:.1f} % [{:.1f}, {:.1f}]".format(*(100 * estimate[k] for k in ["value", "low", "high"]))
number = lambda estimate: "{value:.1f} [{low:.1f}, {high:.1f}]".format(**estimate)
ends = sorted(trial["summary"]["env_steps"] for trial in trials)
quantile = lambda share: f"{ends[int(share * (count - 1))]:,}"
lasting = sum(trial["summary"]["end_reason"] == "lasting" for trial in trials)
lowest = min(trial["best"]["mean"] for trial in trials)
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
| runs that ended with a policy that passed their own test | {lasting:,} of {count:,} |
| steps at the end of the run: 10 %, 50 %, 90 %, all of the seeds | {quantile(0.1)}, {quantile(0.5)}, {quantile(0.9)}, {quantile(1)} |
| best checkpoint lasts | {lasts['best']:,} of {count:,} ({share(lasts['best_share'])}) |
| final policy lasts | {lasts['final']:,} of {count:,} ({share(lasts['final_share'])}) |

Seeds that do not solve the task: {"; ".join(failing) or "none"}.
"""
page = HERE / "default.md"
between = r"(<!-- measured -->\n).*?(<!-- end -->)"
page.write_text(re.sub(between, lambda match: match[1] + table + match[2], page.read_text(), flags=re.S))
