"""Trains the configs of the other tasks over many seeds and writes what came of it into tasks.md and tasks/.

    cargo build --release && pip install "gymnasium[box2d]" && python3 docs/results/tasks.py [--studies DIR] [--quick]

Without --quick it takes an hour and a half on two cores, most of it in LunarLander's program.
"""

import argparse
import csv
import json
import os
import pathlib
import re
import subprocess

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PROGRAM = os.environ.get("CARTPOLE_DQN", ROOT / "target/release/cartpole-dqn")

arguments = argparse.ArgumentParser()
arguments.add_argument("--studies", type=pathlib.Path, default=ROOT / "studies/tasks")
arguments.add_argument("--quick", action="store_true", help="three seeds of each")
arguments = arguments.parse_args()

tasks = [("acrobot", 0), ("mountain_car", 0), ("lunar_lander", 1000)]
rows = ["| config | steps | final policy solves | best policy solves | final mean over seeds; the lowest | steps to solve: 10 %, 50 %, 90 % |",
        "| --- | --- | --- | --- | --- | --- |"]
(HERE / "tasks").mkdir(exist_ok=True)
for name, first in tasks:
    last, out = first + (3 if arguments.quick else 100), arguments.studies / name
    for words in [["study", "--config", ROOT / f"configs/{name}.json", "--seeds", f"{first}..{last}", "--out", out, "--quiet"],
                  ["report", out]]:
        subprocess.run([PROGRAM, *map(str, words)], check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
    config = json.loads((out / "report.json").read_text())["configs"][0]
    study = json.loads((out / "study.json").read_text())["configs"][0]
    lines = {line for path in (out / "trials").glob("*.jsonl") for line in path.read_text().splitlines()}
    trials = sorted(map(json.loads, lines), key=lambda trial: trial["seed"])
    finals = [trial["final"]["mean"] for trial in trials]
    threshold = study["task"]["solved_return"]
    mean, solve = config["final_mean"], config["steps_to_solve"]
    interval = f" [{mean['low']:.1f}, {mean['high']:.1f}]" if len(trials) >= 10 else ""
    quantiles = ", ".join(f"{solve[q]:,}" if solve[q] is not None else "never" for q in ["q10", "q50", "q90"])
    rows.append(f"| `{name}.json` ({study['task']['id']}, ≥ {threshold:g}) | {study['config']['budget']['steps']:,} "
                f"| {config['final_solved']} of {len(trials)} | {config['best_solved']} of {len(trials)} "
                f"| {mean['value']:.1f}{interval}; {min(finals):.1f} | {quantiles} |")
    with open(HERE / f"tasks/{name}.csv", "w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["seed", "best_mean", "final_mean", "solved_at_step", "weights_sha256"])
        for trial in trials:
            summary = trial["summary"]
            table.writerow([trial["seed"], trial["best"]["mean"], trial["final"]["mean"], summary["solved_at_step"],
                            summary["weights_sha256"]])

page = HERE / "tasks.md"
text = page.read_text()
page.write_text(re.sub(r"(?s)(<!-- measured -->\n).*?(<!-- end -->)", lambda found: found[1] + "\n".join(rows) + "\n" + found[2], text))
