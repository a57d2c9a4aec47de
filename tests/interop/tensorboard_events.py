#!/usr/bin/env python3
"""Reads the event files of `train --tensorboard` with TensorBoard and holds them against metrics.jsonl.

    python tensorboard_events.py RUN
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

# Tag -> kind of event and its field; what has no field is checked on its own.
TAGS = {
    "rollout/ep_rew_mean": ("episode", "mean_return_100"),
    "rollout/ep_len_mean": ("episode", None),
    "rollout/exploration_rate": ("episode", "epsilon"),
    "time/total_timesteps": ("episode", "env_steps"),
    "time/fps": ("episode", None),
    "train/loss": ("episode", "loss"),
    "train/n_updates": ("episode", "updates"),
    "train/learning_rate": ("episode", None),
    "eval/mean_reward": ("evaluation", "mean"),
    "eval/mean_ep_length": ("evaluation", "mean_length"),
    "eval/std_reward": ("evaluation", "std"),
    "eval/min_reward": ("evaluation", "min"),
    "eval/max_reward": ("evaluation", "max"),
    "diagnostics/overestimation": ("statistics", "overestimation"),
    "diagnostics/terminal_share": ("statistics", "terminal_share"),
    "diagnostics/max_q": ("statistics", "max_q"),
    "diagnostics/action_gap": ("statistics", "action_gap"),
    "diagnostics/doomed_max_q": ("statistics", "doomed_max_q"),
    "diagnostics/gradient_norm": ("statistics", "gradient_norm"),
    "diagnostics/td_error_q10": ("statistics", "td_error_q10"),
    "diagnostics/td_error_q50": ("statistics", "td_error_q50"),
    "diagnostics/td_error_q90": ("statistics", "td_error_q90"),
    "diagnostics/dead_relu_share": ("statistics", "dead_relu_share"),
}


def require(condition, message):
    if not condition:
        sys.exit(f"FAILED: {message}")


def field(event, name):
    return event[name]


def learning_rate(config, step):
    optimizer = config["optimizer"]
    start, schedule = optimizer["learning_rate"], optimizer["schedule"]
    if schedule is None:
        return start
    share = min(step / schedule["steps"], 1)
    return start + (schedule["final_learning_rate"] - start) * share


def expected(tag, events, config):
    kind, name = TAGS[tag]
    events = [event for event in events if event["event"] == kind]
    steps = [event["env_steps"] for event in events]
    if tag == "rollout/ep_len_mean":
        lengths = [event["length"] for event in events]
        return list(zip(steps, [np.mean(lengths[max(0, i - 99) : i + 1]) for i in range(len(lengths))]))
    if tag == "train/learning_rate":
        return [(step, learning_rate(config, step)) for step in steps]
    return [(event["env_steps"], field(event, name)) for event in events if field(event, name) is not None]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="the directory of a run that has just ended")
    run = parser.parse_args().run
    events = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    config = json.loads((run / "config.json").read_text())
    files = list((run / "tensorboard").iterdir())
    require(len(files) == 1, f"{files} is not one event file")
    # 0: keep every scalar, not a sample of them.
    accumulator = EventAccumulator(str(run / "tensorboard"), size_guidance={"scalars": 0, "tensors": 0})
    accumulator.Reload()
    found = set(accumulator.Tags()["scalars"])
    require(found == set(TAGS), f"tags {sorted(found ^ set(TAGS))} are missing or unknown")

    count = 0
    for tag in TAGS:
        scalars = accumulator.Scalars(tag)
        count += len(scalars)
        times = [scalar.wall_time for scalar in scalars]
        require(times == sorted(times) and abs(times[-1] - time.time()) < 3600, f"{tag}: wall times {times[-3:]}")
        if tag == "time/fps":
            episodes = sum(event["event"] == "episode" for event in events)
            require(len(scalars) == episodes - 1, f"{tag}: {len(scalars)} values for {episodes} episodes")
            require(all(0 < scalar.value < 1e8 for scalar in scalars), f"{tag} is not a speed")
            continue
        wanted = expected(tag, events, config)
        require([scalar.step for scalar in scalars] == [step for step, _ in wanted], f"{tag}: other steps")
        values = np.array([scalar.value for scalar in scalars])
        close = np.isclose(values, np.array([value for _, value in wanted], dtype=np.float32), rtol=1e-6)
        require(close.all(), f"{tag} differs at {np.flatnonzero(~close)[:5]}")
    print(f"{len(TAGS)} tags, {count} scalars: TensorBoard reads what metrics.jsonl holds")


if __name__ == "__main__":
    main()
