"""Trains tables and the default network over many seeds and writes what came of it into q_table.md.

    cargo build --release && python3 docs/results/q_table.py [--studies DIR] [--seeds N] [--grid-seeds N]
"""

import argparse
import json
import os
import pathlib
import re
import subprocess
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PROGRAM = os.environ.get("CARTPOLE_DQN", ROOT / "target/release/cartpole-dqn")
# Cells of x, ẋ, θ and θ̇; the edges of the third are those of Barto, Sutton and Anderson 1983.
CELLS = {
    "6": "[1,1,[0],[-0.29,0.29]]",
    "12": "[1,1,[-0.139,0,0.139],[-0.29,0.29]]",
    "162": "[[-0.8,0.8],[-0.5,0.5],[-0.1047,-0.01745,0,0.01745,0.1047],[-0.8727,0.8727]]",
    "1,296": "[6,6,6,6]",
    "10,000": "[10,10,10,10]",
    "160,000": "[20,20,20,20]",
}
STEPS = [10_000, 50_000, 200_000]

arguments = argparse.ArgumentParser()
arguments.add_argument("--studies", type=pathlib.Path, default=ROOT / "studies/q_table")
arguments.add_argument("--seeds", type=int, default=100)
arguments.add_argument("--grid-seeds", type=int, default=10)
arguments = arguments.parse_args()


def run(*words):
    subprocess.run([PROGRAM, *map(str, words)], check=True, stdout=subprocess.DEVNULL)


def study(name, seeds, *words):
    """The report's configs, in the order of the study, and the trials of each."""
    folder = arguments.studies / name
    run("study", *words, "--seeds", f"0..{seeds}", "--out", folder, "--quiet")
    run("report", folder)
    configs = {config["name"]: config for config in json.loads((folder / "report.json").read_text())["configs"]}
    named = json.loads((folder / "study.json").read_text())["configs"]
    lines = {line for path in (folder / "trials").glob("*.jsonl") for line in path.read_text().splitlines()}
    trials = [json.loads(line) for line in lines]
    return [(configs[config["name"]], [trial for trial in trials if trial["config"] == config["name"]]) for config in named]


def inside(config, *words):
    """The sizes of the checkpoints of a run with seed 0, how long it took, and its last statistics."""
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / "run"
        run("train", "--config", config, *words, "--quiet", "--out", out)
        sizes = [(out / f"checkpoints/{name}.safetensors").stat().st_size for name in ["best", "last"]]
        seconds = json.loads((out / "summary.json").read_text())["wall_seconds"]
        events = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    return sizes, seconds, [event for event in events if event["event"] == "statistics"][-1]


number = lambda estimate: "{value:.1f} [{low:.1f}, {high:.1f}]".format(**estimate)
share = lambda estimate: "{:.0f} % [{:.0f}, {:.0f}]".format(*(100 * estimate[k] for k in ["value", "low", "high"]))


def lasted(trials, policy):
    """How many of 100 seeds have a policy that lasts."""
    return 100 * sum(trial[policy]["lasts"] for trial in trials) / len(trials)


def against_the_network():
    names = {"q_table": "table of 12 cells", "q_table_fine": "table of 10,000 cells, 200,000 steps", "cartpole": "network, the default"}
    rows = []
    for name, title in names.items():
        config = ROOT / f"configs/{name}.json"
        [(summary, trials)] = study(name, arguments.seeds, "--config", config, "--lasting")
        (best, last), seconds, _ = inside(config)
        solve = summary["steps_to_solve"]
        quantile = lambda q: "–" if solve[q] is None else f"{solve[q]:,}"
        rows.append(
            f"| {title} | {summary['final_solved']} ({share(summary['final_solved_share'])}) | {number(summary['final_mean'])} "
            f"| {summary['best_solved']} | {quantile('q10')}, {quantile('q50')}, {quantile('q90')}; never {solve['never']} "
            f"| {lasted(trials, 'final'):.1f} | {lasted(trials, 'best'):.1f} | {best:,}; {last:,} | {seconds:.2f} |"
        )
    head = "| | final ≥ 475, seeds | final mean | best ≥ 475, seeds | steps to solve: 10 %, 50 %, 90 % of seeds | seeds of 100 whose final policy lasts 20,000 steps | the best policy | bytes of `best`; `last` | seconds to train |\n"
    return head + "| --- " * 9 + "|\n" + "\n".join(rows) + "\n"


def cells_and_steps():
    grid = {}
    for steps in STEPS:
        words = ["--set", f"budget.steps={steps}", "--set", f"evaluation.every_steps={steps // 10}"]
        for key in ["optimizer.schedule.steps", "exploration.steps"]:
            words += ["--set", f"{key}={steps // 2}"]
        vary = ["--vary", f"table.bins=[{','.join(CELLS.values())}]", "--vary", "table.mirror=[false,true]"]
        fine = ["--config", ROOT / "configs/q_table_fine.json", "--set", "table.initial=0"]
        configs = study(f"cells_{steps}", arguments.grid_seeds, *fine, *words, *vary)
        for i, (summary, _) in enumerate(configs):
            grid[i // 2, i % 2, steps] = f"{summary['final_solved']} ({summary['final_mean']['value']:.0f})"
    head = "| cells | mirrored | " + " | ".join(f"{steps:,} steps, of {arguments.grid_seeds}" for steps in STEPS) + " | cells visited | updates of each |\n"
    rows = []
    for i, (cells, bins) in enumerate(CELLS.items()):
        sets = [f"table.bins={bins}", "table.initial=0"]
        for mirror in [0, 1]:
            words = [word for set in [*sets, f"table.mirror={str(bool(mirror)).lower()}"] for word in ["--set", set]]
            _, _, numbers = inside(ROOT / "configs/q_table_fine.json", *words)
            visited = f"{100 * numbers['visited_share']:.0f} % | {numbers['visits_per_cell']:,.0f}"
            rows.append(f"| {cells} | {'yes' if mirror else 'no'} | " + " | ".join(grid[i, mirror, steps] for steps in STEPS) + f" | {visited} |")
    return head + "| --- " * 7 + "|\n" + "\n".join(rows) + "\n"


def mountain_car():
    [(summary, trials)] = study("mountain_car", arguments.grid_seeds, "--config", ROOT / "configs/q_table_mountain_car.json")
    best = sum(trial["best"]["mean"] for trial in trials) / len(trials)
    return (
        f"Over {summary['seeds']} seeds the final policy has a mean return of {number(summary['final_mean'])}, and the best policies one of "
        f"{best:.1f}. {summary['final_solved']} final and {summary['best_solved']} best policies reach −110, from which the task counts as solved.\n"
    )


page = HERE / "q_table.md"
for name, measured in [("network", against_the_network), ("cells", cells_and_steps), ("mountain_car", mountain_car)]:
    text, between = measured(), rf"(<!-- {name} -->\n).*?(<!-- end -->)"
    page.write_text(re.sub(between, lambda match: match[1] + text + match[2], page.read_text(), flags=re.S))
