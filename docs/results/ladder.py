"""Trains the ladder and the ablation of the default, and writes ladder.md, ladder/ and the table of docs/ladder.md.

    cargo build --release && python3 docs/results/ladder.py [--studies DIR] [--seeds A..B] [--jobs N]

The CSV files hold no times, so a second run writes the same bytes.
"""

import argparse
import csv
import json
import os
import pathlib
import re
import resource
import shutil
import subprocess

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PROGRAM = os.environ.get("CARTPOLE_DQN", ROOT / "target/release/cartpole-dqn")
OUT = HERE / "ladder"

parser = argparse.ArgumentParser()
parser.add_argument("--studies", type=pathlib.Path, default=ROOT / "studies/ladder")
parser.add_argument("--seeds", default="600000..600100")
parser.add_argument("--jobs", default=str(os.cpu_count()))
arguments = parser.parse_args()

LADDER = sorted((ROOT / "configs/ladder").glob("*.json"))
# The default without its early end, with one part taken away or set back to the tutorial's.
WHOLE_NAME = LADDER[-2].stem
WHOLE = json.loads(LADDER[-2].read_text())
ABLATION = {
    "one_step": {"n_step": 1},
    "hard_target": {"target": {"kind": "hard", "every_episodes": 10}, "policy_weights": "online"},
    "online_policy": {"policy_weights": "online"},
    "gamma_95": {"gamma": 0.95},
    "small_memory": {"replay": WHOLE["replay"] | {"capacity": 2000}},
    "no_mirror": {"replay": WHOLE["replay"] | {"mirror": False}},
    "rate_001": {"optimizer": WHOLE["optimizer"] | {"learning_rate": 0.001}},
    "epsilon_per_episode": {"exploration": {"schedule": "per_episode", "initial": 1.0, "final": 0.01, "decay": 0.995}},
    "no_reward_scale": {"reward_scale": 1.0},
    "episodes_of_500": {"max_episode_steps": None},
    "truncation_is_terminal": {"truncation_is_terminal": True},
    # What the default had before.
    "double": {"double": True},
    "divisors": {"observation_divisors": [2.4, 2.0, 0.2095, 2.0]},
    "64_64": {"network": WHOLE["network"] | {"hidden": [64, 64]}},
}
# Two parts at a time.
SQUARES = {
    "mirror_and_reward_scale": ["no_mirror", "no_reward_scale"],
    "n_step_and_soft_target": ["one_step", "hard_target"],
}


def run(*words):
    subprocess.run([PROGRAM, *map(str, words)], check=True, stdout=subprocess.DEVNULL, stdin=subprocess.DEVNULL)


def cpu():
    taken = resource.getrusage(resource.RUSAGE_CHILDREN)
    return taken.ru_utime + taken.ru_stime


def train(name, config):
    """Trains a config over the seeds in a study of its own, and returns the seconds of CPU that a run takes."""
    run("study", "--config", config, "--seeds", arguments.seeds, "--lasting", "--jobs", arguments.jobs,
        "--out", arguments.studies / name, "--quiet")
    before = cpu()
    for seed in range(5):
        run("train", "--config", config, "--seed", seed, "--out", arguments.studies / "timed", "--force", "--quiet")
    return (cpu() - before) / 5


def merged(name, parts):
    """A study of several that have been trained: their configs and trials. Reports compare with the first."""
    out = arguments.studies / name
    shutil.rmtree(out, ignore_errors=True)
    (out / "trials").mkdir(parents=True)
    studies = [json.loads((arguments.studies / part / "study.json").read_text()) for part in parts]
    configs = [config for study in studies for config in study["configs"]]
    (out / "study.json").write_text(json.dumps(studies[0] | {"configs": configs}))
    for part in parts:
        for file in (arguments.studies / part / "trials").glob("*.jsonl"):
            shutil.copy(file, out / "trials" / f"{part}-{file.name}")
    run("report", out)
    return json.loads((out / "report.json").read_text())


def shown(estimate, digits=1):
    return "{value:.{d}f} [{low:.{d}f}, {high:.{d}f}]".format(**estimate, d=digits)


def steps(config):
    quantiles = (config["steps_to_solve"][q] for q in ["q10", "q50", "q90"])
    return "/".join("–" if steps is None else f"{steps:,}" for steps in quantiles)


def difference(report, name):
    """P(better) than the first config of the report, and the verdict; nothing of the first itself."""
    for other in report["comparisons"]:
        if other["config"] == name:
            verdict = other["verdict"].replace("no_difference_shown", "no effect shown")
            return [shown(other["probability_of_improvement"], 3), verdict]
    return ["", ""]


HEADING = ["final solved", "best solved", "final IQM", "final mean", "steps to solve 10/50/90 %", "collapses", "final lasts"]


def cells(config):
    return [str(config["final_solved"]), str(config["best_solved"]), shown(config["final_iqm"]), shown(config["final_mean"]),
            steps(config), str(config["retention"]["collapses"]), str(config["lasting"]["final"])]


def table(rows):
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + " --- |" * len(rows[0]), *lines[1:]]) + "\n"


def write_csv(name, rows):
    with open(OUT / f"{name}.csv", "w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def replace(page, mark, text):
    between = rf"(?s)(<!-- {mark} -->\n).*?(<!-- end -->)"
    page.write_text(re.sub(between, lambda found: found[1] + text + found[2], page.read_text()))


OUT.mkdir(exist_ok=True)
arguments.studies.mkdir(parents=True, exist_ok=True)
seconds = {path.stem: train(path.stem, path) for path in LADDER}
rows, short = [], [["step", "final solved", "final IQM", "lasts", "over the step before: P(better)", "verdict"]]
for before, path in zip([None, *LADDER], LADDER):
    name = path.stem
    report = merged(f"step_{name}", [before.stem, name] if before else [name])
    config, better = report["configs"][-1], difference(report, name)
    rows.append([name, *cells(config), *better])
    iqm = f"{config['final_iqm']['value']:.1f}"
    short.append([f"`{name}`", str(config["final_solved"]), iqm, str(config["lasting"]["final"]), *better])
    shutil.copy(arguments.studies / f"step_{name}/learning_curves.svg", OUT / f"{name}.svg")
heading = ["step", *HEADING, "P(better) than the step before", "verdict"]
write_csv("ladder", [heading, *rows])
replace(HERE / "ladder.md", "ladder", table([[*heading, "CPU s"]] + [[*row, f"{seconds[row[0]]:.2f}"] for row in rows]))
replace(ROOT / "docs/ladder.md", "ladder", table(short))

files = {}
for name, change in ABLATION.items():
    files[name] = arguments.studies / f"{name}.json"
    files[name].write_text(json.dumps(WHOLE | change))
for name, parts in SQUARES.items():
    both = f"both_{name}"
    files[both] = arguments.studies / f"{both}.json"
    changes = [ABLATION[part] for part in parts]
    files[both].write_text(json.dumps(WHOLE | changes[0] | changes[1]))
seconds |= {name: train(name, path) for name, path in files.items()}
report = merged("ablation", [WHOLE_NAME, *ABLATION])
rows = [[config["name"], *cells(config), *difference(report, config["name"])] for config in report["configs"]]
heading = ["change", *HEADING, "P(better) than the whole", "verdict"]
write_csv("ablation", [heading, *rows])
replace(HERE / "ladder.md", "ablation", table([[*heading, "CPU s"]] + [[*row, f"{seconds[row[0]]:.2f}"] for row in rows]))
rows = []
for name, parts in SQUARES.items():
    report = merged(name, [WHOLE_NAME, *parts, f"both_{name}"])
    rows += [[name, config["name"], *cells(config)] for config in report["configs"]]
write_csv("squares", [["square", "change", *HEADING], *rows])
replace(HERE / "ladder.md", "squares", table([["square", "change", *HEADING], *rows]))
