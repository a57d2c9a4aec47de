"""Searches three settings with Optuna and stops runs that promise little. Needs `pip install optuna` and cartpole-dqn in PATH."""

import json
import subprocess
import time
from pathlib import Path

import optuna
from optuna.trial import TrialState


def events(process, path):
    """The events of a run, as they are written."""
    end = 0
    while True:
        has_ended = process.poll() is not None
        if path.exists():
            with path.open("rb") as file:
                file.seek(end)
                for line in file:
                    if not line.endswith(b"\n"):
                        break  # The rest is still being written.
                    end += len(line)
                    yield json.loads(line)
        if has_ended:
            return
        time.sleep(0.01)


def train(trial, run):
    """The last evaluation of a run; none if the run is pruned."""
    settings = {
        "optimizer.learning_rate": trial.suggest_float("optimizer.learning_rate", 1e-4, 1e-2, log=True),
        "gamma": trial.suggest_float("gamma", 0.9, 0.999),
        "n_step": trial.suggest_int("n_step", 1, 8),
        "budget.steps": 10_000,
    }
    sets = [f"--set={key}={value}" for key, value in settings.items()]
    process = subprocess.Popen(["cartpole-dqn", "train", "--quiet", "--out", run, *sets], stderr=subprocess.DEVNULL)
    for event in events(process, run / "metrics.jsonl"):
        if event["event"] == "evaluation":
            trial.report(event["mean"], event["env_steps"])
            if trial.should_prune():
                process.terminate()
                process.wait()
                return None
    if process.wait() != 0:
        return 0.0  # the run diverged
    return json.loads((run / "summary.json").read_text())["final_evaluation"]["mean"]


pruner = optuna.pruners.MedianPruner(n_startup_trials=5, n_warmup_steps=2_000)
study = optuna.create_study(direction="maximize", sampler=optuna.samplers.TPESampler(seed=0), pruner=pruner)
for _ in range(20):
    trial = study.ask()
    value = train(trial, Path(f"runs/trial-{trial.number}"))
    if value is None:
        study.tell(trial, state=TrialState.PRUNED)
    else:
        study.tell(trial, value)
pruned = sum(trial.state == TrialState.PRUNED for trial in study.trials)
print(len(study.trials), pruned, study.best_value, study.best_params)
