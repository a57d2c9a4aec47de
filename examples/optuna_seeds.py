"""Searches one setting with Optuna. The objective is the interquartile mean over ten seeds."""

import json
import subprocess

import optuna


def objective(trial):
    directory = f"studies/trial-{trial.number}"
    rate = trial.suggest_float("optimizer.learning_rate", 1e-4, 1e-2, log=True)
    sets = [f"--set=optimizer.learning_rate={rate}", "--set=budget.steps=3000"]
    subprocess.run(["cartpole-dqn", "study", "--quiet", "--seeds", "0..10", "--out", directory, *sets])
    report = subprocess.run(["cartpole-dqn", "report", directory, "--json"], check=True, capture_output=True)
    return json.loads(report.stdout)["configs"][0]["final_iqm"]["value"]


study = optuna.create_study(direction="maximize", sampler=optuna.samplers.TPESampler(seed=0))
study.optimize(objective, n_trials=6)
print(len(study.trials), 0, study.best_value, study.best_params)
